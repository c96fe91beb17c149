"""What a model by torque lacks: the torque equation along the measured motion is linear in numbers
and effects, so that every effect is a column, and each set of them is judged by algebra, without a
simulation.
"""
