"""Least squares with covariance.

identifiability      Which parameters data determine: the covariance, and in words the directions
                     without one
levenberg_marquardt  Nonlinear least squares by Optimistix: the solution, its information, what
                     was left over
normal_equations     Levenberg-Marquardt on J^T J and J^T r, where there are too many residuals for
                     a Jacobian
robust               Huber's M-estimator: least squares that no single bad spot can bend
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
