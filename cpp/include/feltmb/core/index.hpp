#pragma once

#include <cstddef>

namespace feltmb {

/// A count or position, held as int as in Eigen and CVODE, as an index of the standard library.
constexpr std::size_t as_index(int i) noexcept { return static_cast<std::size_t>(i); }

}  // namespace feltmb
