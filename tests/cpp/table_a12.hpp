/// Curve fits of the felt and leather contacts, typed again from thesis Table A.12.
#pragma once

#include <array>

#include "feltmb/contact/law.hpp"

namespace table_a12 {

struct Row {
  int contact;
  feltmb::ExponentialCurve loading;
  feltmb::ExponentialCurve unloading;
  double crossing_force;  ///< where the two fits meet [N], design/ACTION.md; 0: not stated
};

inline constexpr std::array<Row, 15> kRows{{
    {1, {5.52e3, 1.58e3, -0.60e3}, {0.19e3, 5.04e3, 3.04e3}, 21.5},
    {2, {2.63e3, 1.36e3, 0.80e3}, {7.8, 0.36e3, 0.21e3}, 0.0},
    {3, {27.0e3, 1.15e3, -22.4e3}, {0.42e3, 5.25e3, 2.74e3}, 51.0},
    {4, {17.0e3, 15.6e3, -4.87e3}, {0.18e3, 43.2e3, 15.3e3}, 33.0},
    {5, {2.62e3, 2.96e3, -1.15e3}, {0.03e3, 7.99e3, 2.48e3}, 28.5},
    {6, {23.5e3, 1.74e3, -24.1e3}, {2.0e3, 4.52e3, -0.82e3}, 52.5},
    {7, {0.14e3, 0.73e3, 0.18e3}, {2.8, 1.61e3, 0.26e3}, 0.0},
    {8, {2.42e3, 1.59e3, -1.16e3}, {0.12e3, 3.62e3, 1.36e3}, 31.5},
    {9, {70.8e3, 0.10e3, -70.3e3}, {5.49e3, 0.94e3, -6.38e3}, 8.7},
    {10, {0.28e3, 1.00e3, 0.22e3}, {9.5, 2.30e3, 0.33e3}, 10.0},
    {11, {0.44e3, 1.63e3, 0.50e3}, {10.0, 3.55e3, 0.80e3}, 22.0},
    {12, {0.47e3, 1.23e3, -0.09e3}, {0.03e3, 2.77e3, 0.24e3}, 6.7},
    {13, {2.62e3, 1.84e3, -2.37e3}, {0.12e3, 4.13e3, 1.12e3}, 33.0},
    {14, {2.62e3, 1.84e3, -2.37e3}, {0.12e3, 4.13e3, 1.12e3}, 33.0},
    {15, {27.0e3, 2.64e3, -22.71e3}, {3.07e3, 6.23e3, -2.96e3}, 52.0},
}};

}  // namespace table_a12
