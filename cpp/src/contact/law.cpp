#include "feltmb/contact/law.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"

namespace feltmb {
namespace {

void require(bool ok, const char* field, double value, const char* range) {
  if (!ok) throw InvalidParameter(format("%s = %.6g, must be %s", field, value, range));
}

void check(const ExponentialCurve& curve, const char* which) {
  for (const double value : {curve.a, curve.b, curve.c}) {
    if (!std::isfinite(value)) {
      throw InvalidParameter(format("%s curve: coefficient is not a finite number", which));
    }
  }
  if (curve.b < 0.0) {
    throw InvalidParameter(format("%s curve: b = %.6g 1/m, must be >= 0", which, curve.b));
  }
}

void check(const LawParameters& parameters) {
  if (const auto* pair = std::get_if<ExponentialPair>(&parameters)) {
    check(pair->loading, "loading");
    check(pair->unloading, "unloading");
    require(std::isfinite(pair->alpha) && pair->alpha > 0.0, "alpha [s/m]", pair->alpha, "> 0");
  } else if (const auto* mean = std::get_if<MeanCurve>(&parameters)) {
    check(mean->loading, "loading");
    check(mean->unloading, "unloading");
  } else if (const auto* hc = std::get_if<HuntCrossley>(&parameters)) {
    require(std::isfinite(hc->stiffness) && hc->stiffness > 0.0, "stiffness [N/m^p]",
            hc->stiffness, "> 0");
    require(std::isfinite(hc->exponent) && hc->exponent >= 1.0, "exponent", hc->exponent, ">= 1");
    require(std::isfinite(hc->damping) && hc->damping >= 0.0, "damping [s/m]", hc->damping,
            ">= 0");
  }
}

/// Where a e exp(b e) + c e turns positive: 0 if it is positive from the start.
double first_positive_compression(const ExponentialCurve& curve) {
  if (curve.a + curve.c >= 0.0 || curve.a <= 0.0 || curve.b <= 0.0) return 0.0;
  return std::log(-curve.c / curve.a) / curve.b;
}

double mean_integral(const MeanCurve& mean, double e) {
  return 0.5 * (integral(mean.loading, e) + integral(mean.unloading, e));
}

/// The mean of two exponential curves has no closed first root: bisection on the sign of F/e.
double first_positive_compression(const MeanCurve& mean) {
  const auto sign = [&](double e) {
    return evaluate(mean.loading, e).force + evaluate(mean.unloading, e).force;
  };
  double low = 1e-12;
  if (sign(low) >= 0.0) return 0.0;
  double high = 1e-6;
  while (sign(high) < 0.0) {
    high *= 2.0;
    if (high > 1.0) return 0.0;
  }
  for (int i = 0; i < 200 && high - low > 1e-18; ++i) {
    const double middle = 0.5 * (low + high);
    (sign(middle) < 0.0 ? low : high) = middle;
  }
  return high;
}

LawValue evaluate_pair(const ExponentialPair& pair, double e, double rate) {
  CurveValue load = evaluate(pair.loading, e);
  const bool guarded = pair.form == ExponentialPair::Form::kGuarded;
  if (guarded && load.force <= 0.0) return {};
  if (rate >= 0.0) return {load.force, load.slope, 0.0};
  CurveValue unload = evaluate(pair.unloading, e);
  if (guarded) {
    if (unload.force < 0.0) unload = {0.0, 0.0};
    if (unload.force > load.force) unload = load;
  }
  const double t = std::tanh(pair.alpha * rate);
  const double band = load.force - unload.force;
  return {load.force + band * t, load.slope + (load.slope - unload.slope) * t,
          band * pair.alpha * (1.0 - t * t)};
}

}  // namespace

ContactLaw::ContactLaw(const LawParameters& parameters) : parameters_(parameters) {
  check(parameters);
  if (const auto* pair = std::get_if<ExponentialPair>(&parameters)) {
    if (pair->form == ExponentialPair::Form::kGuarded) {
      first_positive_ = first_positive_compression(pair->loading);
      energy_offset_ = integral(pair->loading, first_positive_);
    }
  } else if (const auto* mean = std::get_if<MeanCurve>(&parameters)) {
    first_positive_ = first_positive_compression(*mean);
    energy_offset_ = mean_integral(*mean, first_positive_);
  }
}

std::string ContactLaw::name() const {
  if (const auto* pair = std::get_if<ExponentialPair>(&parameters_)) {
    return pair->form == ExponentialPair::Form::kGuarded ? "guarded" : "printed";
  }
  if (std::holds_alternative<MeanCurve>(parameters_)) return "mean";
  return "hunt_crossley";
}

LawValue ContactLaw::evaluate(double compression, double rate) const {
  if (compression <= 0.0) return {};
  if (const auto* pair = std::get_if<ExponentialPair>(&parameters_)) {
    return evaluate_pair(*pair, compression, rate);
  }
  if (const auto* mean = std::get_if<MeanCurve>(&parameters_)) {
    const CurveValue load = feltmb::evaluate(mean->loading, compression);
    const CurveValue unload = feltmb::evaluate(mean->unloading, compression);
    const double force = 0.5 * (load.force + unload.force);
    if (force <= 0.0) return {};
    return {force, 0.5 * (load.slope + unload.slope), 0.0};
  }
  const auto& hc = std::get<HuntCrossley>(parameters_);
  const double elastic = hc.stiffness * std::pow(compression, hc.exponent);
  const double factor = 1.0 + hc.damping * rate;
  if (factor <= 0.0) return {};
  return {elastic * factor, hc.exponent * elastic / compression * factor, elastic * hc.damping};
}

double ContactLaw::stored_energy(double compression) const {
  if (compression <= first_positive_) {
    const auto* pair = std::get_if<ExponentialPair>(&parameters_);
    const bool printed = pair != nullptr && pair->form == ExponentialPair::Form::kPrinted;
    return printed && compression > 0.0 ? integral(pair->loading, compression) : 0.0;
  }
  if (const auto* pair = std::get_if<ExponentialPair>(&parameters_)) {
    return integral(pair->loading, compression) - energy_offset_;
  }
  if (const auto* mean = std::get_if<MeanCurve>(&parameters_)) {
    return mean_integral(*mean, compression) - energy_offset_;
  }
  const auto& hc = std::get<HuntCrossley>(parameters_);
  return hc.stiffness * std::pow(compression, hc.exponent + 1.0) / (hc.exponent + 1.0);
}

double ContactLaw::elastic_force(double compression) const {
  if (const auto* hc = std::get_if<HuntCrossley>(&parameters_)) {
    return compression <= 0.0 ? 0.0 : hc->stiffness * std::pow(compression, hc->exponent);
  }
  return evaluate(compression, 0.0).force;
}

}  // namespace feltmb
