#include "feltmb/fiber/contact_count.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/fiber/faults.hpp"
#include "feltmb/numeric/constants.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {
namespace {

void check(ContactModel model, const ContactInput& input) {
  const std::string& name = contact_model_names()[static_cast<std::size_t>(model)];
  Faults faults("contacts, model \"" + name + "\"");
  if (!(input.v_f > 0.0 && input.v_f < 1.0)) {
    faults.add("v_f", input.v_f, "", "> 0 and < 1", "fiber volume over total volume");
  }
  faults.positive("d_f", input.d_f, "m");
  if (!(input.f > 0.0 && input.f <= 1.0)) faults.add("f", input.f, "", "> 0 and <= 1");
  if (!(input.sine > 0.0 && input.sine <= 1.0)) {
    faults.add("sine", input.sine, "", "> 0 and <= 1");
  }
  if (model == ContactModel::pan) {
    faults.positive("obstruction", input.obstruction, "",
                    "infinite for an exactly planar network: Pan's model has no planar limit");
  }
  if (model == ContactModel::binomial) {
    faults.positive("gamma", input.gamma, "",
                    "blocked fiber length per contact over d_f; geometry gives pi/2");
    if (!std::isnan(input.Q)) faults.positive("Q", input.Q, "", "2 for isotropic fibers");
  }
  faults.not_negative("diameter_cv", input.diameter_cv, "");
  if (input.diameter_cv > 0.0 && model != ContactModel::komori_makishima &&
      model != ContactModel::poisson && model != ContactModel::toll) {
    faults.add("diameter_cv", input.diameter_cv, "", "0",
               "only komori_makishima, poisson and toll know a distribution of diameters");
  }
  if (input.as_printed && model != ContactModel::van_wyk_tube) {
    faults.add_text("as_printed = true, expected false (only van_wyk_tube has a printed variant)");
  }
  faults.raise_if_any();
}

double binomial_share(const ContactInput& input) {
  const double q = std::isnan(input.Q) ? 8.0 * input.f / kPi : input.Q;
  return -std::expm1(-q * input.gamma * input.v_f);
}

void check_count(ContactModel model, const CountInput& input) {
  const std::string& name = contact_model_names()[static_cast<std::size_t>(model)];
  Faults faults("contact count, model \"" + name + "\"");
  if (model != ContactModel::poisson && model != ContactModel::binomial) {
    faults.add_text("has no distribution of the number of contacts, expected poisson or binomial");
  }
  if (!(input.v_f > 0.0 && input.v_f < 1.0)) faults.add("v_f", input.v_f, "", "> 0 and < 1");
  faults.positive("d_f", input.d_f, "m");
  faults.positive("fiber_length", input.fiber_length, "m");
  faults.within("ratio", input.ratio, 1e-3, 1e6, "");
  faults.within("length_cv", input.length_cv, 0.0, 3.0, "");
  if (model == ContactModel::binomial) faults.positive("gamma", input.gamma, "");
  faults.raise_if_any();
}

/// Rule for averages over fibers: polar angles with weights of sum 1.
struct FiberRule {
  std::vector<double> sine, weight;  ///< J(theta) and its share of the fibers
};

FiberRule make_fiber_rule(double ratio) {
  FiberRule rule;
  if (ratio == 1.0) return {{kPi / 4.0}, {1.0}};
  // g, the cosine before deformation, is uniform; grading at g = 1 for strong compression.
  const double end = std::min(0.5, 1.0 / (ratio * ratio));
  const double range = std::log1p(1.0 / end);
  const auto panels = static_cast<std::size_t>(std::ceil(range)) + 1;
  for (std::size_t panel = 0; panel < panels; ++panel) {
    const double width = range / static_cast<double>(panels);
    for (std::size_t i = 0; i < gauss16().nodes.size(); ++i) {
      const double t = width * (static_cast<double>(panel) + 0.5 * (1.0 + gauss16().nodes[i]));
      const double g = std::clamp(1.0 - end * std::expm1(t), 0.0, 1.0);
      const double cosine = g / std::sqrt(ratio * ratio * (1.0 - g) * (1.0 + g) + g * g);
      rule.sine.push_back(uniaxial_mean_sine(ratio, cosine));
      rule.weight.push_back(0.5 * width * gauss16().weights[i] * end * std::exp(t));
    }
  }
  return rule;
}

/// Lengths over their mean with weights of sum 1: nodes of a gamma distribution.
FiberRule make_length_rule(double cv) {
  if (cv == 0.0) return {{1.0}, {1.0}};
  const double shape = 1.0 / (cv * cv);
  FiberRule rule;
  double total = 0.0;
  // x = exp(u) makes the density smooth at 0 for every shape.
  const double low = -40.0 / shape - 12.0 * cv;
  const double high = std::log(1.0 + 12.0 * cv + 40.0 * cv * cv);
  constexpr std::size_t kPanels = 40;
  for (std::size_t panel = 0; panel < kPanels; ++panel) {
    const double width = (high - low) / kPanels;
    for (std::size_t i = 0; i < gauss16().nodes.size(); ++i) {
      const double u =
          low + width * (static_cast<double>(panel) + 0.5 * (1.0 + gauss16().nodes[i]));
      const double weight = gauss16().weights[i] * std::exp(shape * (u + 1.0 - std::exp(u)));
      rule.sine.push_back(std::exp(u));
      rule.weight.push_back(weight);
      total += weight;
    }
  }
  for (double& weight : rule.weight) weight /= total;
  return rule;
}

}  // namespace

const std::vector<std::string>& contact_model_names() {
  static const auto& names = *new std::vector<std::string>{
      "van_wyk", "van_wyk_tube", "komori_makishima", "pan", "poisson", "binomial", "toll"};
  return names;
}

ContactModel contact_model(const std::string& name) {
  const auto& names = contact_model_names();
  const auto found = std::find(names.begin(), names.end(), name);
  if (found == names.end()) {
    std::string list;
    for (const std::string& known : names) list += (list.empty() ? "" : ", ") + known;
    throw InvalidParameter("contacts: model = \"" + name + "\", must be one of " + list);
  }
  return static_cast<ContactModel>(found - names.begin());
}

double fiber_length_per_volume(const ContactInput& input) {
  return 4.0 * input.v_f /
         (kPi * input.d_f * input.d_f * (1.0 + input.diameter_cv * input.diameter_cv));
}

double mean_free_length(ContactModel model, const ContactInput& input) {
  check(model, input);
  const double d = input.d_f;
  const double v = input.v_f;
  switch (model) {
    case ContactModel::van_wyk:
      return kPi * d / (8.0 * v * input.sine);
    case ContactModel::van_wyk_tube: {
      // Length in the tube per height pi d^2 l_v over the mean chord pi d / (2 <sin>).
      if (input.as_printed) return 64.0 / (2.0 * kPi * kPi * kPi) * kPi * d / (4.0 * v);
      const double chord = kPi * d / (2.0 * input.sine);
      return chord / (kPi * d * d * fiber_length_per_volume(input));
    }
    case ContactModel::pan:
      return (kPi + 4.0 * v * input.obstruction) * d / (8.0 * v * input.f);
    case ContactModel::binomial:
      return input.gamma * d / binomial_share(input);
    case ContactModel::komori_makishima:
    case ContactModel::poisson:
    case ContactModel::toll:
      break;
  }
  return 1.0 / (2.0 * d * fiber_length_per_volume(input) * input.f);
}

double contacts_per_volume(ContactModel model, const ContactInput& input,
                           ContactCounting counting) {
  const double once = fiber_length_per_volume(input) / (2.0 * mean_free_length(model, input));
  const bool both = counting == ContactCounting::ends ||
                    (counting == ContactCounting::source && model == ContactModel::toll);
  return both ? 2.0 * once : once;
}

std::vector<double> contact_count_distribution(ContactModel model, const CountInput& input,
                                               std::size_t k_max) {
  check_count(model, input);
  if (k_max > 100000) {
    throw InvalidParameter(format("contact count: k_max = %zu, must be <= 100000", k_max));
  }
  std::vector<double> result(k_max + 1, 0.0);
  const FiberRule fibers = make_fiber_rule(input.ratio);
  const FiberRule lengths = make_length_rule(input.length_cv);
  for (std::size_t l = 0; l < lengths.weight.size(); ++l) {
    const double length = lengths.sine[l] * input.fiber_length;
    for (std::size_t j = 0; j < fibers.weight.size(); ++j) {
      const double weight = lengths.weight[l] * fibers.weight[j];
      if (weight < 1e-300) continue;
      const double mean = 8.0 * input.v_f * length * fibers.sine[j] / (kPi * input.d_f);
      if (model == ContactModel::poisson) {
        for (std::size_t k = 0; k <= k_max; ++k) {
          const auto n = static_cast<double>(k);
          result[k] += weight * std::exp(-mean + n * std::log(mean) - std::lgamma(n + 1.0));
        }
      } else {
        const double slots = std::max(1.0, std::round(length / (input.gamma * input.d_f)));
        const double empty = -mean / slots;
        const double log_taken = std::log(-std::expm1(empty));
        for (std::size_t k = 0; k <= std::min(k_max, static_cast<std::size_t>(slots)); ++k) {
          const auto n = static_cast<double>(k);
          result[k] +=
              weight * std::exp(std::lgamma(slots + 1.0) - std::lgamma(n + 1.0) -
                                std::lgamma(slots - n + 1.0) + n * log_taken + (slots - n) * empty);
        }
      }
    }
  }
  return result;
}

double free_length_survival(ContactModel model, const CountInput& input, double x) {
  check_count(model, input);
  if (!(x >= 0.0)) {
    throw InvalidParameter(format("free length: x = %.6g m, must be >= 0", x));
  }
  const FiberRule fibers = make_fiber_rule(input.ratio);
  double sum = 0.0;
  double total = 0.0;
  for (std::size_t j = 0; j < fibers.weight.size(); ++j) {
    const double density = 8.0 * input.v_f * fibers.sine[j] / (kPi * input.d_f);
    if (model == ContactModel::poisson) {
      // Weighted by the number of free lengths a fiber contributes.
      const double weight = fibers.weight[j] * density;
      sum += weight * std::exp(-density * x);
      total += weight;
    } else {
      const double slot = input.gamma * input.d_f;
      const double weight = fibers.weight[j] * -std::expm1(-density * slot);
      sum += weight * std::exp(-density * slot * std::floor(x / slot));
      total += weight;
    }
  }
  return sum / total;
}

}  // namespace feltmb
