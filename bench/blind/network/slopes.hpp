/// Derivatives by the wanted columns: sparse for what is constant in time, rows for what moves.
#pragma once

#include <cstddef>
#include <vector>

namespace feltmb::lumped {

/// Derivative `value` by the column (or state) `index`; all others are zero.
struct Slope {
  std::size_t index;
  double value;
};
using Slopes = std::vector<Slope>;

/// to += factor * slopes
inline void append(Slopes& to, double factor, const Slopes& slopes) {
  for (const Slope& s : slopes) {
    to.push_back({s.index, factor * s.value});
  }
}

/// A number that is constant in time, such as a stiffness, with its derivatives.
struct Number {
  double v = 0.0;
  Slopes d;

  /// Neither it nor any of its derivatives is other than zero.
  bool dead() const { return v == 0.0 && d.empty(); }
};

/// 1 / a
Number reciprocal(const Number& a);

/// A row of derivatives with its factor.
struct Term {
  double factor;
  const double* row;
};

/// to = sum of factor * row, elementwise in the order of the terms, so that neither the width nor
/// the vectors of the machine change a bit. `to` may be one of the rows.
///
/// `width`: a multiple of `row_block`.
void combine(double* to, const Term* terms, std::size_t count, std::size_t width);

/// Rows of derivatives are padded to whole blocks.
inline constexpr std::size_t row_block = 4;

}  // namespace feltmb::lumped
