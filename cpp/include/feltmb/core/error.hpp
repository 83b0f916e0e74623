/// Exceptions of the core. Every message says what, where, got, expected, hint.
#pragma once

#include <stdexcept>
#include <string>

namespace feltmb {

/// Root of all exceptions that feltmb throws on purpose.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A parameter, description or argument is outside its permitted range.
class InvalidParameter : public Error {
 public:
  using Error::Error;
};

/// A model cannot do what was asked of it (no equilibrium, singular mass matrix, ...).
class ModelError : public Error {
 public:
  using Error::Error;
};

/// printf-like message with `%.6g` numbers; std::to_string would print small times as zero.
[[gnu::format(printf, 1, 2)]] std::string format(const char* pattern, ...);

}  // namespace feltmb
