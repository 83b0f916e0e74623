"""Experiments: what the next record would tell about parameters and effects, and which one to make.

The information of a planned record follows from the derivatives of the model, as in a diagnosis.
"""
