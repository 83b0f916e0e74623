/// A formula in compression and rate: text, parsed once, evaluated with its exact slopes.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include "feltmb/contact/laws/concept.hpp"

namespace feltmb {

/// Numbers, parameters, `e` [m], `rate` [m/s] and `pi`; + - * / ^, parentheses; exp log sqrt tanh
/// abs sign of one and min max pow of two arguments. ^ binds closest and to the right; -a^b is
/// -(a^b). Evaluated as a flat program on dual numbers; nothing of it is executed as code.
class Formula {
 public:
  static constexpr std::size_t kMostLetters = 1000;
  static constexpr std::size_t kMostParameters = 100;
  static constexpr int kDeepest = 40;  ///< of parentheses, signs and powers in each other

  /// Throws InvalidParameter naming the place of the first fault.
  Formula(const std::string& text, const std::map<std::string, double>& parameters);

  /// Value and slopes by e and rate; NaN where the formula is not defined.
  LawValue evaluate(double e, double rate) const;

  /// Active branches of min, max, abs and sign, as one number >= 0.
  int choices(double e, double rate) const;

 private:
  // clang-format off
  enum class Op : unsigned char {
    kNumber, kCompression, kRate,
    kAdd, kSubtract, kMultiply, kDivide, kPower, kMin, kMax,
    kNegate, kExp, kLog, kSqrt, kTanh, kAbs, kSign,
  };
  // clang-format on
  struct Step {
    Op op;
    double number;
  };
  class Parser;
  template <class Choose>
  LawValue run(double e, double rate, Choose&& choose) const;

  std::vector<Step> steps_;
};

}  // namespace feltmb
