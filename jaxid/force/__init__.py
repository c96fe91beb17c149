"""The force that a model lacks along a measured motion: the motion and its filter, what the drive
makes of the inputs, and least squares on the columns of the model's numbers.
"""
