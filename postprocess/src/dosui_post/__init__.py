"""Reads, verifies and draws the results of dosui.

Units are SI, pore pressure is compression positive, z points up and is always the third
column of the points: (0, 0, z) in 1-D, (x, 0, z) in 2-D.
"""

__version__ = "0.1.0"
