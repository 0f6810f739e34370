"""Judge solvers: a checkpoint against the material point method on one page, the stress suite, the chart.

`evaluate` brings solvers, files and figures together. Nothing here changes a simulator.
"""
