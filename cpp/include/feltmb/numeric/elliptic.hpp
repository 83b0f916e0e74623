/// Carlson's symmetric elliptic integrals by duplication.
///
/// Source: B. C. Carlson, Numerical Algorithms 10 (1995) 13; NIST DLMF 19.16, 19.36.
/// They give differences such as K - E without cancellation, which Legendre's forms do not.
#pragma once

namespace feltmb {

/// R_F(x, y, z) = (1/2) int_0^inf dt / sqrt((t+x)(t+y)(t+z)).
/// x, y, z >= 0, at most one zero. Relative error below 1e-14. Returns NaN outside.
double carlson_rf(double x, double y, double z);

/// R_D(x, y, z) = (3/2) int_0^inf dt / (sqrt((t+x)(t+y)) (t+z)^(3/2)).
/// x, y >= 0, at most one zero; z > 0. Relative error below 1e-14. Returns NaN outside.
double carlson_rd(double x, double y, double z);

}  // namespace feltmb
