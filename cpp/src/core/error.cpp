#include "feltmb/core/error.hpp"

#include <cstdarg>
#include <cstdio>
#include <vector>

namespace feltmb {

const char* error_code_name(ErrorCode code) {
  switch (code) {
    case ErrorCode::kNone:
      return "";
    case ErrorCode::kInvalidParameter:
      return "invalid_parameter";
    case ErrorCode::kNoEquilibrium:
      return "no_equilibrium";
    case ErrorCode::kBeyondString:
      return "beyond_string";
    case ErrorCode::kNotFinite:
      return "not_finite";
    case ErrorCode::kNotConverged:
      return "not_converged";
    case ErrorCode::kNoProgress:
      return "no_progress";
    case ErrorCode::kTooManySteps:
      return "too_many_steps";
    case ErrorCode::kWallTime:
      return "wall_time";
    case ErrorCode::kInterrupted:
      return "interrupted";
    case ErrorCode::kEnergyBalance:
      return "energy_balance";
    case ErrorCode::kOther:
      break;
  }
  return "other";
}

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
