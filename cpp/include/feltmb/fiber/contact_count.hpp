/// Number of fiber-to-fiber contacts and the free length between them.
///
/// Symbols: v_f fiber volume fraction, d_f fiber diameter, l_v = 4 v_f / (pi d_f^2) fiber length
/// per volume, f = mean |e x e'| (pi/4 isotropic, 2/pi planar).
/// Sources: thesis 3.1.3, eqs. 3.1-3.15, 3.50, 3.51; C. van Wyk 1946 [115], T. Komori and
/// K. Makishima [52], N. Pan [76], B. Neckar and D. Das [74], S. Toll [110].
///
/// Every model satisfies lambda = l_v / (2 N_v) when each contact is counted once: a contact ends
/// two segments (eq. 3.61, whose first form lacks the factor 2).
#pragma once

#include <cstddef>
#include <limits>
#include <string>
#include <vector>

#include "feltmb/fiber/orientation.hpp"

namespace feltmb {

enum class ContactModel {
  van_wyk,           ///< eq. 3.1 repaired: sphere of diameter d_f moving along axis 3
  van_wyk_tube,      ///< eq. 3.2: fiber length in a tube over mean chord; equal to 3.1 when right
  komori_makishima,  ///< eqs. 3.4-3.6, any orientation
  pan,               ///< eqs. 3.7-3.10, length blocked by earlier contacts
  poisson,           ///< eq. 3.11, means equal to komori_makishima
  binomial,          ///< eqs. 3.12-3.15, Neckar and Das
  toll               ///< eqs. 3.50, 3.51; 3.51 counts a contact once on each of its two fibers
};

/// Model of a public name ("van_wyk", ...). Throws InvalidParameter listing the names.
ContactModel contact_model(const std::string& name);
/// Names in the order of ContactModel.
const std::vector<std::string>& contact_model_names();

/// How a contact between two fibers is counted in contacts_per_volume.
enum class ContactCounting {
  source,  ///< as the model's source: `toll` on both fibers, every other model once
  once,    ///< one per pair of fibers that touch
  ends     ///< once on each fiber, twice per pair
};

/// What the contact models need to know about the network.
struct ContactInput {
  double v_f;                                  ///< volume fraction [-], 0 < v_f < 1
  double d_f;                                  ///< mean fiber diameter [m], > 0
  double f = 0.78539816339744830962;           ///< [-], (0, 1]; default isotropic, pi/4
  double sine = 0.78539816339744830962;        ///< mean sin theta [-] (van Wyk's vertical path)
  double obstruction = 1.2337005501361698274;  ///< Psi [-] (Pan); default isotropic, pi^2/8
  double gamma = std::numeric_limits<double>::quiet_NaN();  ///< blocked length per contact over
                                                            ///< d_f [-] > 0 (binomial only)
  double Q = std::numeric_limits<double>::quiet_NaN();      ///< [-] > 0 (binomial); default 8 f/pi
  double diameter_cv = 0.0;  ///< standard deviation over mean of the diameters, by length [-] >= 0;
                             ///< komori_makishima, poisson and toll only
  bool as_printed = false;   ///< van_wyk_tube: constant of eq. 3.2 as printed, (4/pi)^2 too long
};

/// Fiber length per volume l_v [1/m^2]: 4 v_f / (pi d_f^2 (1 + cv^2)).
double fiber_length_per_volume(const ContactInput& input);

/// Mean distance between neighboring contacts along a fiber, lambda [m].
/// van Wyk d/(2 v) isotropic; Pan (pi + 4 v Psi) d / (8 v f), isotropic (2 + pi v) d/(4 v)
/// (eq. 3.10); binomial gamma d / (1 - exp(-Q gamma v)) (eq. 3.15); others pi d/(8 f v).
/// Throws InvalidParameter naming all faults.
double mean_free_length(ContactModel model, const ContactInput& input);

/// Contacts per volume N_v [1/m^3]. komori_makishima: d_f l_v^2 f (eq. 3.6).
double contacts_per_volume(ContactModel model, const ContactInput& input,
                           ContactCounting counting = ContactCounting::source);

/// Contacts on one fiber of given length: distribution over k = 0 .. k_max.
struct CountInput {
  double v_f;              ///< [-], 0 < v_f < 1
  double d_f;              ///< [m] > 0
  double fiber_length;     ///< mean length delta_f [m] > 0, straight over this length
  double ratio = 1.0;      ///< orientation R; contacts are mixed over the fibers' directions
  double length_cv = 0.0;  ///< coefficient of variation of a gamma distribution of lengths [-]
  double gamma = std::numeric_limits<double>::quiet_NaN();  ///< [-] > 0 (binomial only)
};

/// Probability of k contacts on a fiber, k = 0 .. k_max, mixed over direction and length.
/// poisson: eq. 3.11. binomial: eq. 3.13 with nu_m = delta_f / (gamma d_f) slots, rounded to a
/// whole number >= 1 (the mean of the Poisson variable is kept).
/// Other models have no count distribution: InvalidParameter.
std::vector<double> contact_count_distribution(ContactModel model, const CountInput& input,
                                               std::size_t k_max);

/// Probability that a free length exceeds x [m] (x >= 0).
/// poisson (and the models that share its mean): mixture of exponentials over direction, weighted
/// by contacts; binomial: slots of length gamma d_f, each taken with S = 1 - exp(-Q gamma v).
double free_length_survival(ContactModel model, const CountInput& input, double x);

}  // namespace feltmb
