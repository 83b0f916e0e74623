#include "feltmb/core/error.hpp"

#include <cstdarg>
#include <cstdio>
#include <vector>

namespace feltmb {

std::string format(const char* pattern, ...) {
  va_list args;
  va_start(args, pattern);
  va_list copy;
  va_copy(copy, args);
  const int size = std::vsnprintf(nullptr, 0, pattern, args);
  va_end(args);
  std::vector<char> buffer(static_cast<std::size_t>(size < 0 ? 0 : size) + 1);
  std::vsnprintf(buffer.data(), buffer.size(), pattern, copy);
  va_end(copy);
  return {buffer.data()};
}

}  // namespace feltmb
