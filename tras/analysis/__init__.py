"""What a control engineer asks of a fitted model: residual tests, criteria, the linear system at a point, responses.

In this order: `residuals`, `linearization`, `responses`. The models' methods call the first two, the page of
`tras.identify` all of them.
"""
