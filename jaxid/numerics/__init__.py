"""What XLA needs and no mechanics: elementary functions, small matrices, batched loops, exported
programs.
"""
