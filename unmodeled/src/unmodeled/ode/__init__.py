"""Integration of equations: rates of NumPy are traced once, many jobs run with derivatives.

It knows records and jobs, and nothing of a fit or a diagnosis.
"""

from unmodeled.ode.integrator import Derivatives, Integrator

__all__ = ["Derivatives", "Integrator"]
