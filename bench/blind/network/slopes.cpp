#include "slopes.hpp"

#include "feltmb/core/multiversion.hpp"

namespace feltmb::lumped {

Number reciprocal(const Number& a) {
  Number r;
  r.v = 1.0 / a.v;
  append(r.d, -r.v * r.v, a.d);
  return r;
}

// Sums stay in registers: sixteen columns at a time, then four.
FELTMB_CLONES void combine(double* to, const Term* terms, std::size_t count, std::size_t width) {
  std::size_t at = 0;
  for (; at + 16 <= width; at += 16) {
    double sum[16] = {};
    for (std::size_t t = 0; t < count; ++t) {
      const double factor = terms[t].factor;
      const double* row = terms[t].row + at;
      for (std::size_t i = 0; i < 16; ++i) {
        sum[i] += factor * row[i];
      }
    }
    for (std::size_t i = 0; i < 16; ++i) {
      to[at + i] = sum[i];
    }
  }
  for (; at < width; at += row_block) {
    double sum[row_block] = {};
    for (std::size_t t = 0; t < count; ++t) {
      const double factor = terms[t].factor;
      const double* row = terms[t].row + at;
      for (std::size_t i = 0; i < row_block; ++i) {
        sum[i] += factor * row[i];
      }
    }
    for (std::size_t i = 0; i < row_block; ++i) {
      to[at + i] = sum[i];
    }
  }
}

}  // namespace feltmb::lumped
