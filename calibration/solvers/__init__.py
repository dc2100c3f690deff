"""Least squares with covariance.

blocks               Gauss-Newton for shared parameters and blocks with parameters of their own
chi_squared          Chi squared against its degrees of freedom: the range that noise explains
identifiability      Covariance, and the parameters that the data do not determine, in words
levenberg_marquardt  Nonlinear least squares by Optimistix
normal_equations     Levenberg-Marquardt on J^T J and J^T r, without a Jacobian in memory
robust               Huber's M-estimator, which limits the influence of outliers
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
