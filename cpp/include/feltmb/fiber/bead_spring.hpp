/// Fiber by fiber: a periodic box of bead-spring fibers, compressed and released slowly.
///
/// Energy (thesis eq. 2.10, after Jarai-Szabo [43] and Barbier [5, 6]):
///   stretching  K_S/2 (1 - s/l)^2 per segment,             K_S = E A l [J]
///   bending     K_B/2 (phi - phi0)^2 per inner bead,       K_B = E I / l [J]
///               phi = pi - theta is the turning angle, phi0 that of the unloaded, crimped shape
///   repulsion   between segments that are not consecutive, r the distance of their axes:
///     logarithmic  -K_I ln(r/r_cut) exp(r/(r - r_cut)) for r < r_cut, else 0 (smooth at r_cut)
///     hertz        K_I/2 (1 - r/d_f)^(5/2) for r < d_f, else 0 (section 2.2.2)
/// Torsion is left out, as in the source. Coulomb friction: a tangential spring at each contact,
/// cut to mu times the normal force (stick and slip, rate independent).
/// Motion: velocity Verlet with drag on the velocity relative to the affine flow; the box and all
/// beads are strained along axis 3 by a small amount each step, so slow that inertia and drag
/// matter little (check: EnergyBooks). Pressure is the virial stress.
///
/// Every segment pair counts for itself: two segments of one fiber near the same bead both push.
/// Results do not depend on the number of threads, bit for bit.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "feltmb/fiber/orientation.hpp"

namespace feltmb {

enum class Repulsion { hertz, logarithmic };

/// Fibers, material and numerics. SI units.
struct BeadSpringParams {
  std::size_t n_fibers = 60;        ///< 2 .. 100 000
  std::size_t n_beads = 31;         ///< per fiber, 2 .. 10 000
  double d_f = 25e-6;               ///< fiber diameter [m] > 0
  double segment_length = 62.5e-6;  ///< l [m] >= d_f
  double v_f = 0.1;                 ///< volume fraction of the first, cubic box [-], (0, 0.5)
  double crimp = 0.3;               ///< root mean square turning angle per bead [rad], 0 .. 1
  double ratio = 1.0;               ///< orientation R of the fibers as laid
  std::uint64_t seed = 0;
  double E = 2.5e9;         ///< fiber modulus [Pa] > 0
  double density = 1310.0;  ///< of the fiber [kg/m^3] > 0
  Repulsion repulsion = Repulsion::hertz;
  double interaction = 0.0;  ///< K_I [J]; 0: 0.41 E d_f^3, Hertz for crossed cylinders
  double friction = 0.0;     ///< mu [-] >= 0
  double tangential = 0.3;   ///< tangential spring over normal stiffness at 5 % overlap [-]
  double drag = 0.001;       ///< rate of drag over the highest stretching frequency [-] > 0
  double time_step = 0.2;    ///< step over the inverse of that frequency [-], (0, 0.8]
};

/// Throws InvalidParameter naming all faults.
void validate(const BeadSpringParams& params);

/// Measured quantities at one time.
struct BeadSpringSample {
  std::size_t step;          ///< steps since the start
  double v_f;                ///< fiber volume over box volume [-]
  double strain;             ///< true strain along axis 3 since the start, ln(v_f / v_f start) [-]
  double pressure;           ///< along axis 3 [Pa], compression positive
  double lateral;            ///< mean of axes 1 and 2 [Pa]
  double stretching;         ///< energy [J]
  double bending;            ///< energy [J]
  double repulsion;          ///< energy [J]
  double tangential;         ///< energy of the tangential springs [J]
  double kinetic;            ///< energy [J], relative to the affine flow
  double work;               ///< work of the box on the network since the start [J]
  double friction_loss;      ///< dissipated by sliding since the start [J]
  double drag_loss;          ///< dissipated by drag since the start [J]
  std::size_t contacts;      ///< places where two fibers touch (r < d_f, or r_cut), each once
  double smallest_distance;  ///< smallest r over d_f among the contacts [-]; 1 without contacts
  double max_force;          ///< largest residual force on a bead over E d_f^2 [-]
};

/// Complete state for a restart, as arrays that can be stored.
struct BeadSpringState {
  std::vector<double> positions;    ///< [m], n_fibers * n_beads * 3, not wrapped
  std::vector<double> velocities;   ///< [m/s], same
  std::vector<double> rest_angles;  ///< phi0 [rad], n_fibers * n_beads
  std::vector<double> box;          ///< sides [m], 3
  std::vector<double> books;        ///< step, start fraction, work, friction and drag losses
  std::vector<std::int64_t> contact_pairs;  ///< segments a < b of sticking contacts, flat
  std::vector<double> contact_springs;      ///< tangential elongation [m], 3 each
};

/// A box of fibers. It cannot be copied, and only one thread at a time may use it.
class BeadSpringNetwork {
 public:
  /// Lays the fibers at random, uniform in place, with the orientation density of `ratio`;
  /// overlaps are not avoided. @param threads 0: all cores (fewer for
  /// small boxes)
  explicit BeadSpringNetwork(const BeadSpringParams& params, std::size_t threads = 0);
  /// Continues from a stored state; the result is the same, bit for bit, as without the
  /// interruption.
  BeadSpringNetwork(const BeadSpringParams& params, const BeadSpringState& state,
                    std::size_t threads = 0);
  ~BeadSpringNetwork();

  /// Steps without straining, repulsion capped to a soft potential (Hertz with K_I/20) and strong
  /// drag, to remove the overlaps of the random laying. Velocities are set to zero afterwards.
  /// Work and losses of the relaxation are not booked.
  void relax(std::size_t steps);

  /// Steps with the true strain `strain_per_step` along axis 3 (positive compresses). Throws
  /// ModelError if a side of the box becomes too short for the neighbor search, or if a bead moves
  /// by more than a segment in one step.
  void advance(std::size_t steps, double strain_per_step);

  [[nodiscard]] BeadSpringSample sample();
  [[nodiscard]] BeadSpringState state() const;
  [[nodiscard]] const BeadSpringParams& params() const;

  /// Largest volume fraction [-] to which this box can be compressed; the height of the box is then
  /// the smallest one for the neighbor search.
  [[nodiscard]] double densest() const;

  /// Total potential energy [J] of the present positions and forces on all beads [N] (without
  /// friction), for tests.
  double energy_and_forces(std::vector<double>& forces);

  /// Crossings of fiber axes closer than d_f whose closest points are not fiber ends. Toll's and
  /// van Wyk's formulas count these (each contact once).
  [[nodiscard]] std::size_t crossings();

  /// Directions of all segments [-].
  [[nodiscard]] Directions directions() const;

  /// Free lengths between neighboring contacts along the fibers [m] (inner ones only).
  [[nodiscard]] std::vector<double> free_lengths();

 private:
  struct Implementation;
  std::unique_ptr<Implementation> self_;
};

}  // namespace feltmb
