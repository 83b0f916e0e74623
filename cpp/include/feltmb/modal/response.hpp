/// Exact response of uncoupled modes to forces that are polynomials of time within a step.
///
/// Mode: x'' + d x' + k x = p(t). With g the response to a unit impulse and G_m its m-fold integral
/// over time (G_0 = g), a step of length h is
///   x(h) = (g' + d g) x + g v + sum p_m m!/h^m G_(m+1),
///   v(h) = -k g x + g' v     + sum p_m m!/h^m G_m,            p = sum p_m (t/h)^m,
/// exact for any step, damping and frequency, rigid modes (k = d = 0) included. The shortest steps
/// sum the Taylor series; each longer one follows from two of half its length, so that no sine or
/// exponential is formed (C. Moler, C. Van Loan, SIAM Review 45 (2003) 3, "scaling and squaring").
#pragma once

#include <cstddef>
#include <vector>

namespace feltmb::modal {

/// The functions of one step length, each by mode.
struct StepResponse {
  double step = 0.0;  ///< h [s]
  /// Impulse response: slope g' [-], g [s], integrals G_1 [s^2], G_2 [s^3], G_3 [s^4].
  std::vector<double> slope, impulse, first, second, third;
};

/// Weights that advance the modes over one step under forces given at its start, middle and end
/// (a parabola of time): x = xx x + xv v + x0 f0 + xm fm + x1 f1, v likewise.
struct StepWeights {
  std::vector<double> xx, xv, vx, vv;
  std::vector<double> x0, xm, x1, v0, vm, v1;
};

/// Responses at the step lengths longest / 2^level, made when first asked for. One a thread.
class ModalResponse {
 public:
  /// Stiffness k = w^2 [1/s^2] >= 0 and damping d = 2 xi w [1/s] >= 0 of each mode. Throws
  /// InvalidParameter.
  ModalResponse(std::vector<double> stiffness, std::vector<double> damping, double longest);

  std::size_t modes() const { return stiffness_.size(); }
  double step(int level) const;

  /// Response over longest / 2^level, 0 <= level <= kMaxLevel.
  const StepResponse& at(int level);

  /// Response over any step [s] > 0; not kept.
  StepResponse over(double step) const;

  /// Weights of a step with its whole response given.
  StepWeights weights(const StepResponse& whole) const;

  const std::vector<double>& stiffness() const { return stiffness_; }
  const std::vector<double>& damping() const { return damping_; }

  static constexpr int kMaxLevel = 40;

 private:
  std::vector<double> stiffness_, damping_;
  double longest_;
  double fastest_;                    ///< bound on |eigenvalue| [1/s]
  std::vector<StepResponse> levels_;  ///< step 0: not made yet

  StepResponse taylor(double step) const;
  StepResponse doubled(const StepResponse& half) const;
};

}  // namespace feltmb::modal
