/// Exceptions of the core. Every message states what, where, the value, the expectation, a hint.
#pragma once

#include <stdexcept>
#include <string>

namespace feltmb {

/// Cause of an error or of a run that stopped early, for programs; messages are for people.
enum class ErrorCode {
  kNone,              ///< no error
  kInvalidParameter,  ///< outside the permitted range
  kNoEquilibrium,     ///< no rest pose was reached, or the bodies cannot be there
  kBeyondString,      ///< a contact is beyond the ends of its string
  kNotFinite,         ///< a result is not a number
  kNotConverged,      ///< an iteration or an integrator stopped without a result
  kNoProgress,        ///< steps are too small to get anywhere
  kTooManySteps,
  kWallTime,
  kInterrupted,    ///< by the caller
  kEnergyBalance,  ///< too much energy is unaccounted for
  kOther,
};

/// As users of Python read it: "invalid_parameter", "no_equilibrium", ...; "" of kNone.
const char* error_code_name(ErrorCode code);

/// Base class of all exceptions that feltmb throws intentionally.
class Error : public std::runtime_error {
 public:
  explicit Error(const std::string& message, ErrorCode code = ErrorCode::kOther)
      : std::runtime_error(message), code_(code) {}

  ErrorCode code() const noexcept { return code_; }

 private:
  ErrorCode code_;
};

/// A parameter, description or argument is outside its permitted range.
class InvalidParameter : public Error {
 public:
  explicit InvalidParameter(const std::string& message)
      : Error(message, ErrorCode::kInvalidParameter) {}
};

/// A model cannot compute a requested result (no equilibrium, singular mass matrix, ...).
class ModelError : public Error {
 public:
  using Error::Error;
};

/// printf-like message with `%.6g` numbers; std::to_string would print small times as zero.
[[gnu::format(printf, 1, 2)]] std::string format(const char* pattern, ...);

}  // namespace feltmb
