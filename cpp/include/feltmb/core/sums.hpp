/// Sums over arrays with a fixed number of partial sums: the same bits on every machine.
#pragma once

#include <cstddef>

namespace feltmb {

double sum_absolute(std::size_t n, const double* x);                           ///< sum |x|
double sum_squares(std::size_t n, const double* x);                            ///< sum x^2
double sum_products(std::size_t n, const double* x, const double* y);          ///< sum x y
double sum_weighted_squares(std::size_t n, const double* w, const double* x);  ///< sum w x^2

}  // namespace feltmb
