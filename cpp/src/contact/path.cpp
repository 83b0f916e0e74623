#include "feltmb/contact/path.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"

namespace feltmb {
namespace {

constexpr int kSubsteps = 64;  // of a step, for laws that are not advanced exactly

}  // namespace

LawPath::LawPath(const ContactLaw& law) : law_(&law) {}

void LawPath::reset() { at_ = {}; }

void LawPath::move(double compression, double duration) {
  if (law_->recovery_time() > 0.0 && at_.compression <= 0.0) {
    at_.largest *= std::exp(-duration / law_->recovery_time());
    law_->turn(0.0, at_.largest, at_.turns);
  }
  if (law_->advance(at_, compression, duration)) return;
  if (law_->n_states() > 0) {
    move_by_substeps(compression, duration);
  } else if (law_->has_memory()) {
    at_.largest = std::max(at_.largest, law_->felt_compression(compression, memory()));
  }
  at_.compression = compression;
}

/// Linearly implicit midpoint steps of the law's own states.
void LawPath::move_by_substeps(double compression, double duration) {
  const double rate = (compression - at_.compression) / duration;
  const double h = duration / kSubsteps;
  const double start = at_.compression;
  for (int i = 0; i < kSubsteps; ++i) {
    const double e = start + rate * h * (i + 0.5);
    LawStates v;
    law_->evaluate(e, rate, memory(), &v);
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
      at_.state[a] += change[static_cast<Eigen::Index>(a)];
    }
    law_->limit(at_.state.data());
    if (!law_->has_memory()) continue;
    const double reached = law_->felt_compression(start + rate * h * (i + 1), memory());
    law_->widen(reached, at_.largest, at_.state.data());
    at_.largest = std::max(at_.largest, reached);
  }
}

std::vector<double> LawPath::save() const {
  std::vector<double> out{at_.compression, at_.largest};
  out.insert(out.end(), at_.state.begin(), at_.state.begin() + law_->n_states());
  for (const TurningPoint& turn : at_.turns) out.push_back(turn.compression);
  return out;
}

void LawPath::restore(std::span<const double> saved) {
  const std::size_t least = 2 + law_->n_states();
  if (saved.size() < least || (saved.size() > least && !law_->has_turns())) {
    throw InvalidParameter(format("state of a felt: got %zu numbers, law %s has %zu", saved.size(),
                                  law_->name().c_str(), least));
  }
  for (const double number : saved) {
    if (!std::isfinite(number)) throw InvalidParameter("state of a felt: a number is not finite");
  }
  at_ = {};
  at_.compression = saved[0];
  at_.largest = saved[1];
  std::copy_n(saved.begin() + 2, law_->n_states(), at_.state.begin());
  for (const double e : saved.subspan(least)) law_->turn(e, at_.largest, at_.turns);
}

double LawPath::step(double compression, double duration) {
  const double rate = (compression - at_.compression) / duration;
  move(compression, duration);
  return law_->evaluate(at_.compression, rate, memory()).force;
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
