"""Least squares over a stream of rows: the accuracy of a QR decomposition at the price of matrix products.

Read `least_squares` first, then the `basis` that it works in. `prediction_error` goes on from there to coefficients
that predict many steps ahead, `stability` bounds the spectral radius of a linear model, `threads` says how many threads
a fit takes.
"""
