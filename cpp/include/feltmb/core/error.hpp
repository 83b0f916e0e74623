/// Exceptions of the core. Every message states what, where, the value, the expectation, a hint.
#pragma once

#include <stdexcept>
#include <string>

namespace feltmb {

/// Base class of all exceptions that feltmb throws intentionally.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A parameter, description or argument is outside its permitted range.
class InvalidParameter : public Error {
 public:
  using Error::Error;
};

/// A model cannot compute a requested result (no equilibrium, singular mass matrix, ...).
class ModelError : public Error {
 public:
  using Error::Error;
};

/// printf-like message with `%.6g` numbers; std::to_string would print small times as zero.
[[gnu::format(printf, 1, 2)]] std::string format(const char* pattern, ...);

}  // namespace feltmb
