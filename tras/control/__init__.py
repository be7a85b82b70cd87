"""From an identified model to a controller: LQR, model predictive control, an observer.

Read `predictors` (what a controller needs of a model, with exact slopes), `controller` (what all have in common: names,
limits, the estimate of the state), `lqr`, `mpc` with its quadratic programs `qp`, `observer`. Behind `make control` are
`design` (settings, and the run that the model predicts), `margins`, `page` and `command`.
"""
