/// Energy method for a mass of fiber segments (Komori and Itoh [47]; Lee and Carnaby [56, 57]).
///
/// A segment between contacts has arc length L and chord b; it starts as a circular arc with
/// b/L = chord_ratio = sin(a1)/a1 (a: half the arc's angle, curvature 2 a / L). Under affine
/// stretch s = |F e| of its chord, at constant arc length, it becomes the arc with
/// sin(a)/a = chord_ratio s and stores 2 E I (a - a1)^2 / L (thesis 2.2.1, eq. 2.6):
///   s < 1                    bending (curvature grows),
///   1 < s < 1/chord_ratio    straightening (curvature falls),
///   s > 1/chord_ratio        slipping: straight, stores 2 E I a1^2 / L; the excess length
///                            (chord_ratio s - 1) L is drawn out against `slip_force`.
/// Contacts stay as they are at v_f0 ("no new contact"), so that the stress is the derivative of
/// one energy. With chord_ratio = 1 (Komori-Itoh) a segment must buckle first: the stress jumps
/// to a finite value at the onset of compression.
/// Segment length L: mean free length at v_f0, pi d/(8 f v_f0) (eq. 3.50), equal or gamma
/// distributed; the energy needs <1/L> only.
#pragma once

#include <span>
#include <vector>

namespace feltmb {

/// How the mass is compressed along axis 3.
enum class CompressionScheme {
  isotropic,  ///< F = s I; pressure hydrostatic
  confined,   ///< lateral dimensions held
  simple      ///< no lateral stress: the lateral stretch minimizes energy plus slip work
};

/// Mass and segments.
struct EnergyParams {
  double E;                   ///< fiber modulus [Pa] > 0
  double v_f0;                ///< volume fraction at rest [-], 0 < v_f0 < 1
  double chord_ratio = 1.0;   ///< b/L at rest [-], (0.05, 1]; 1 straight, lower more crimp
  double ratio = 1.0;         ///< orientation at rest, R of orientation.hpp
  double length_shape = 0.0;  ///< shape of a gamma distribution of L, > 1; 0: equal lengths
  double slip_stress = 0.0;   ///< slip force over d_f^2 [Pa] >= 0
};

/// State of the mass at one strain.
struct EnergyState {
  double strain;               ///< engineering compression along axis 3, 1 - stretch [-]
  double lateral_stretch;      ///< [-], 1 when confined
  double v_f;                  ///< volume fraction [-]
  double pressure;             ///< stress along axis 3, compression positive, per current area [Pa]
  double bending;              ///< stored in bending segments [J per m^3 of fiber]
  double straightening;        ///< stored in straightening segments [J/m^3]
  double slipping;             ///< stored in slipping segments, now straight [J/m^3]
  double slip_work;            ///< spent against the slip force (not stored) [J/m^3]
  double bending_share;        ///< fraction of segments that bend [-]
  double straightening_share;  ///< ... straighten [-]
  double slipping_share;       ///< ... slip [-]
};

/// Throws InvalidParameter naming all faults.
void validate(const EnergyParams& params);

/// State at given lateral and axial stretch (> 0) of the mass; pressure = work-conjugate axial
/// stress. Checked parameters are assumed.
EnergyState evaluate_energy(const EnergyParams& params, double axial_stretch,
                            double lateral_stretch);

/// Axial stress with both stretches tied as the scheme says.
/// @param strain  engineering compression of the axial dimension [-], 0 <= strain < 1
/// Throws ModelError for simple compression without equilibrium (straight segments cannot give
/// way sideways unless they slip against a force).
EnergyState compress_energy(const EnergyParams& params, CompressionScheme scheme, double strain);

}  // namespace feltmb
