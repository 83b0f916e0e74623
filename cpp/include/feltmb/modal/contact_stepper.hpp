/// Linear modes that meet a few nonlinear scalar forces: string and hammer, beam and stop.
///
/// Modes q_j'' + d_j q_j' + k_j q_j = sum over contacts -s_cj F_c + sum over drives b_dj u_d(t),
/// compression e_c = offset_c + sum s_cj q_j, F_c = F_c(e_c, de_c/dt). Rigid modes have k = d = 0.
/// Within a step the forces are parabolas of time through their values at its start, middle and
/// end, and the modes answer exactly (ModalResponse): no frequency and no damping limits the step.
/// The two new values of each contact are found by Newton's method on them alone. The error of the
/// parabola, from what the parabola before predicted, chooses the step among halves of the sample
/// interval. Error of the force O(h^3), of the motion O(h^4), while the force is smooth.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "feltmb/modal/response.hpp"

namespace feltmb::modal {

/// A scalar force with a memory of its own, if any. The stepper knows nothing else of it.
class ScalarForce {
 public:
  struct Value {
    double force = 0.0;          ///< F [N], > 0 pushes apart; zero for compression <= 0
    double d_compression = 0.0;  ///< dF/de [N/m]
    double d_rate = 0.0;         ///< dF/d(de/dt) [N s/m]
  };

  virtual ~ScalarForce() = default;

  /// Force at a trial point `elapsed` [s] after the one before: stage 0 follows the last accepted
  /// point, stage 1 follows the last trial of stage 0. Compression e [m], rate de/dt [m/s].
  virtual Value trial(int stage, double elapsed, double compression, double rate) = 0;

  /// The last trials of both stages are final.
  virtual void accept() {}
};

/// Force between modes; the object pointed to must outlive the stepper.
struct ModalContact {
  std::vector<double> gradient;  ///< s = de/dq by mode
  double offset = 0.0;           ///< e at q = 0 [m], negative: a gap
  ScalarForce* force = nullptr;
};

/// Given input u(t) with its generalized forces b u; a parabola of time within a step.
struct ModalDrive {
  std::vector<double> shape;            ///< b by mode
  std::function<double(double)> value;  ///< u at t [s]
  double largest = 0.0;                 ///< scale of u that its error is measured against, > 0
};

struct ModalStepperOptions {
  double interval = 5e-5;    ///< between samples, the longest step [s], > 0
  double tolerance = 1e-5;   ///< error of a force within a step over the largest one, in (0, 0.1]
  double force_scale = 1.0;  ///< the largest force is taken as at least this [N], > 0
  int deepest = 24;          ///< shortest step: interval / 2^deepest, 1 to 30
};

struct ModalStepperCounts {
  long steps = 0;  ///< accepted, free intervals included
  long rejected = 0;
  long free = 0;    ///< intervals crossed in one rotation
  long forces = 0;  ///< evaluations of scalar forces
};

/// A contact closes or opens.
struct ModalEvent {
  double time = 0.0;  ///< [s]
  int contact = 0;
  int direction = 0;  ///< +1 closes, -1 opens
  double rate = 0.0;  ///< de/dt there [m/s]
};

class ModalContactStepper {
 public:
  /// Throws InvalidParameter that lists what is wrong.
  ModalContactStepper(std::vector<double> stiffness, std::vector<double> damping,
                      std::vector<ModalContact> contacts, std::vector<ModalDrive> drives,
                      const ModalStepperOptions& options);

  /// Starts at t [s] from modal positions and velocities; forces as the contacts give there.
  void start(double t, std::span<const double> position, std::span<const double> velocity);

  /// Goes on by one interval. Throws Error when the forces cannot be found at the shortest step.
  void advance();

  double time() const;  ///< [s]
  std::span<const double> position() const { return x_; }
  std::span<const double> velocity() const { return v_; }
  double force(std::size_t contact) const { return now_[contact].force; }  ///< [N]
  double compression(std::size_t contact) const;                           ///< [m]
  double rate(std::size_t contact) const;                                  ///< [m/s]

  double largest_force(std::size_t contact) const { return peak_[contact].force; }  ///< [N]
  double largest_force_time(std::size_t contact) const { return peak_[contact].time; }
  const std::vector<ModalEvent>& events() const { return events_; }
  const ModalStepperCounts& counts() const { return counts_; }

 private:
  /// What a step of one length needs.
  struct Table {
    bool ready = false;
    StepWeights weights;
    std::vector<double> rows;  ///< by contact: e, de/dt at the middle, then at the end, by (x, v)
    /// By contact and channel: e(middle), de/dt(middle), e(end), de/dt(end) for unit f0, fm, f1.
    std::vector<double> answer;
  };
  struct Point {
    double force = 0.0, compression = 0.0, rate = 0.0;
    double d_rate = 0.0;  ///< dF/d(de/dt)
  };
  struct Past {
    double middle = 0.0, start = 0.0;  ///< forces within the step before
  };
  struct Peak {
    double force = 0.0, time = 0.0;
  };

  const Table& table(int level);
  double clock(long tick) const;
  bool cross_freely();
  bool step(int level, long tick, double& error);
  bool find_forces(const Table& t, double h, double limit);
  bool solve(std::size_t n);
  void record(std::size_t contact, double begin, double h);

  ModalResponse response_;
  std::vector<ModalContact> contacts_;
  std::vector<ModalDrive> drives_;
  ModalStepperOptions options_;
  std::size_t n_ = 0;
  std::vector<Table> tables_;
  std::vector<double> x_, v_;
  std::vector<Point> now_, middle_, end_;
  std::vector<Past> past_;
  std::vector<Peak> peak_;
  double past_step_ = 0.0;  ///< 0: nothing to predict from
  std::vector<double> drive_now_, drive_middle_, drive_end_;
  std::vector<std::size_t> rigid_;  ///< modes without stiffness
  std::vector<double> reach_;
  bool reach_known_ = false;
  double start_ = 0.0;
  long intervals_ = 0;
  int level_ = 3;
  int calm_ = 0;  ///< steps in a row that could have been twice as long
  std::vector<double> known_, trial_, matrix_, right_;
  std::vector<ModalEvent> events_;
  ModalStepperCounts counts_;
};

}  // namespace feltmb::modal
