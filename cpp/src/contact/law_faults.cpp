#include "law_faults.hpp"

#include <cmath>
#include <string>

#include "feltmb/core/error.hpp"

namespace feltmb {
namespace {

/// Collects what is wrong with a law, to tell all of it in one message.
class LawFaults {
 public:
  void require(bool ok, const char* field, double value, const char* range) {
    if (!ok) add(format("%s = %.6g, must be %s", field, value, range));
  }
  void add(const std::string& text) { text_ += (text_.empty() ? "" : "; ") + text; }
  void raise() const {
    if (!text_.empty()) throw InvalidParameter(text_);
  }

  void curve(const ExponentialCurve& curve, const char* which) {
    for (const auto& [name, value] : {std::pair{"a [N/m]", curve.a}, {"c [N/m]", curve.c}}) {
      if (!std::isfinite(value)) {
        add(format("%s curve: %s = %.6g, must be finite", which, name, value));
      }
    }
    if (!(std::isfinite(curve.b) && curve.b >= 0.0)) {
      add(format("%s curve: b = %.6g 1/m, must be finite and >= 0", which, curve.b));
    }
  }
  /// A term with a time of its own, which it needs if it is there.
  void rate_term(double amplitude, double time) {
    not_negative(amplitude, "rate_amplitude");
    require(amplitude == 0.0 || positive(time), "rate_time [s]", time, "> 0 with a rate term");
  }
  void not_negative(double value, const char* field) {
    require(std::isfinite(value) && value >= 0.0, field, value, ">= 0");
  }
  static bool positive(double value) { return std::isfinite(value) && value > 0.0; }

  void operator()(const ExponentialPair& p) {
    curve(p.loading, "loading");
    curve(p.unloading, "unloading");
    require(positive(p.alpha), "alpha [s/m]", p.alpha, "> 0");
    not_negative(p.hysteresis, "hysteresis");
    rate_term(p.rate_amplitude, p.rate_time);
  }
  void operator()(const MeanCurve& p) {
    curve(p.loading, "loading");
    curve(p.unloading, "unloading");
  }
  void operator()(const HuntCrossley& p) {
    power(p.stiffness, p.exponent);
    not_negative(p.damping, "damping [s/m]");
  }
  void operator()(const Stulov& p) {
    power(p.stiffness, p.exponent);
    require(p.amplitude >= 0.0 && p.amplitude < 1.0, "amplitude", p.amplitude, "in [0, 1)");
    require(positive(p.time), "time [s]", p.time, "> 0");
  }
  void operator()(const FeltMemory& p) {
    if (!p.envelope) add("felt_memory: envelope is missing");
    require(p.kappa > 0.0 && p.kappa <= 2.0, "kappa", p.kappa, "in (0, 2]");
    not_negative(p.wiping_out, "wiping_out");
    not_negative(p.recovery_time, "recovery_time [s]");
    not_negative(p.creep_stiffness, "creep_stiffness [N/m]");
    require(p.creep_stiffness == 0.0 || positive(p.creep_damping), "creep_damping [N s/m]",
            p.creep_damping, "> 0 with creep");
    rate_term(p.rate_amplitude, p.rate_time);
  }

 private:
  void power(double stiffness, double exponent) {
    require(positive(stiffness), "stiffness [N/m^p]", stiffness, "> 0");
    require(std::isfinite(exponent) && exponent >= 1.0, "exponent", exponent, ">= 1");
  }

  std::string text_;
};

}  // namespace

void check_law(const LawParameters& parameters) {
  LawFaults faults;
  std::visit(faults, parameters);
  faults.raise();
}

}  // namespace feltmb
