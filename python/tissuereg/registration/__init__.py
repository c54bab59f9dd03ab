"""Registration of a deformed body to tracked markers: the public functions, their inputs, results and checks.

The subpackages hold the two methods (`contacts`, without a trained model, and `learned`, with one) and the detection of
misread input (`readings`).
"""
