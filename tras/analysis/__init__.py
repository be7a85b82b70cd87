"""What a control engineer asks of a fitted model: residual tests, information criteria, the linear system at a point.

In this order: `residuals`, `linearization`. The models' methods of these names call them.
"""
