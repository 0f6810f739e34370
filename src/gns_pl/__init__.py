"""gns_pl: learned simulators of three-dimensional granular flow, trained on the material point method.

A `Scene` goes in, a `Trajectory` comes out; the material point solver and the learned simulator are two ways across.
Importing this package stays light: nothing heavier than the standard library is imported here.
"""

__version__ = "0.1.0"
