"""The chart of speed against accuracy: `benchmark.py`.

`entries` says what stands on it, `baselines` what costs next to nothing, `converged` what all are judged by; `speed`
and `batches` measure, side by side, into the tables of `rows`, which a killed run goes on with. From these and the
`plan` it is drawn anywhere: `points` sums up, `front` compares, `costs` knows what was spent before, `verdicts` and
`words` say it, `records` hands it to `simulate.py tolerance=…`. Material point method and learned simulators go through
the same checks here.
"""
