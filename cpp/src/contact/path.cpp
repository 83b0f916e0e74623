#include "feltmb/contact/path.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {
namespace {

constexpr int kSubsteps = 64;  // of a step, for creep and overstress

}  // namespace

LawPath::LawPath(const ContactLaw& law) : law_(&law) {}

void LawPath::reset() {
  compression_ = 0.0;
  largest_ = 0.0;
  state_ = {};
}

/// Exact change of z between two compressions on the same side of e_m and of 0.
void LawPath::move_within(double to) {
  const auto& felt = std::get<FeltMemory>(law_->parameters());
  const double from = compression_;
  compression_ = to;
  if (std::max(from, to) <= 0.0 || std::min(from, to) >= largest_ || from == to) return;
  const double length = felt.kappa * felt.envelope->loop_area(largest_).force;
  if (length <= 0.0) return;
  const double area = std::fabs(integrate_composite(
      [&](double e) {
        return felt.envelope->loading(e).force *
               (1.0 - felt.envelope->ratio(e / largest_, largest_).force);
      },
      std::min(from, to), std::max(from, to), 1));
  double decay = std::exp(-area / length);
  if (felt.wiping_out > 0.0) {
    // Exact too: lengths grow linearly with the area since the return point.
    const Envelope& envelope = *felt.envelope;
    const double whole = envelope.loop_area(largest_).force;
    const double low = std::clamp(std::min(from, to), 0.0, largest_);
    const double below = std::clamp(
        envelope.loading_energy(low) - envelope.unloading_energy(low, largest_), 0.0, whole);
    const double since = to > from ? below : std::max(0.0, whole - below - area);
    const double start = length + felt.wiping_out * since;
    decay = std::pow(1.0 + felt.wiping_out * area / start, -1.0 / felt.wiping_out);
  }
  state_[0] = to > from ? 1.0 - (1.0 - state_[0]) * decay : state_[0] * decay;
}

void LawPath::move(double compression, double duration) {
  if (const auto* st = std::get_if<Stulov>(&law_->parameters())) {
    const auto power = [&](double e) { return e > 0.0 ? std::pow(e, st->exponent) : 0.0; };
    // e^p taken linear within the step: exact exponential of the linear equation.
    const double before = power(compression_);
    const double after = power(compression);
    const double x = duration / st->time;
    const double decay = std::exp(-x);
    const double mean = x > 1e-8 ? (1.0 - decay) / x : 1.0 - 0.5 * x;
    state_[0] = state_[0] * decay + before * (mean - decay) + after * (1.0 - mean);
    compression_ = compression;
    return;
  }
  const auto* felt = std::get_if<FeltMemory>(&law_->parameters());
  if (felt == nullptr) {
    compression_ = compression;
    return;
  }
  if (felt->recovery_time > 0.0 && compression_ <= 0.0) {
    largest_ *= std::exp(-duration / felt->recovery_time);
  }
  if (law_->n_states() == 1) {
    // Split where the branch changes: at zero and at the remembered compression.
    const double from = compression_;
    double stops[2] = {0.0, largest_};
    if (compression < from) std::swap(stops[0], stops[1]);
    for (const double stop : stops) {
      if ((stop - from) * (compression - stop) > 0.0) move_within(stop);
    }
    move_within(compression);
    largest_ = std::max(largest_, compression_);
    return;
  }
  const double rate = (compression - compression_) / duration;
  const double h = duration / kSubsteps;
  const double start = compression_;
  for (int i = 0; i < kSubsteps; ++i) {
    const double e = start + rate * h * (i + 0.5);
    // Linearly implicit midpoint step of the law's own states.
    LawStates v;
    law_->evaluate(e, rate, {state_.data(), largest_}, &v);
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Identity();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (std::size_t a = 0; a < law_->n_states(); ++a) {
      const auto row = static_cast<Eigen::Index>(a);
      right[row] = h * v.rate[a];
      for (std::size_t b = 0; b < law_->n_states(); ++b) {
        matrix(row, static_cast<Eigen::Index>(b)) -= 0.5 * h * v.rate_by_state[a][b];
      }
    }
    const Eigen::Vector3d change = matrix.inverse() * right;
    for (std::size_t a = 0; a < law_->n_states(); ++a) {
      state_[a] += change[static_cast<Eigen::Index>(a)];
    }
    state_[0] = std::clamp(state_[0], 0.0, 1.0);
    const double inner =
        law_->felt_compression(start + rate * h * (i + 1), {state_.data(), largest_});
    largest_ = std::max(largest_, inner);
  }
  compression_ = compression;
}

double LawPath::step(double compression, double duration) {
  const double rate = (compression - compression_) / duration;
  move(compression, duration);
  return law_->evaluate(compression_, rate, {state_.data(), largest_}).force;
}

double LawPath::peek(double compression, double duration) const {
  LawPath copy = *this;
  return copy.step(compression, duration);
}

std::vector<double> force_along(const ContactLaw& law, std::span<const double> time,
                                std::span<const double> compression) {
  if (time.empty() || time.size() != compression.size()) {
    throw InvalidParameter(
        format("path: got %zu times and %zu compressions, expected equal and "
               ">= 1",
               time.size(), compression.size()));
  }
  for (std::size_t i = 0; i < time.size(); ++i) {
    if (!std::isfinite(time[i]) || !std::isfinite(compression[i])) {
      throw InvalidParameter(format("path: sample %zu is not a finite number", i));
    }
    if (i > 0 && time[i] <= time[i - 1]) {
      throw InvalidParameter(format("path: time %.9g s of sample %zu does not follow %.9g s",
                                    time[i], i, time[i - 1]));
    }
  }
  LawPath path(law);
  std::vector<double> out(time.size());
  const double first = time.size() > 1 ? time[1] - time[0] : 1.0;
  out[0] = path.step(compression[0], first);
  for (std::size_t i = 1; i < time.size(); ++i) {
    out[i] = path.step(compression[i], time[i] - time[i - 1]);
  }
  return out;
}

}  // namespace feltmb
