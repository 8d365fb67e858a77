"""Pure geometry and physics on NumPy arrays: no I/O, no clock, no logging, no torch.

`training` calls the very same functions, so that a network is served on what it was trained on.
"""
