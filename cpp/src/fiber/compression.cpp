#include "feltmb/fiber/compression.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "feltmb/fiber/energy_method.hpp"
#include "feltmb/fiber/faults.hpp"
#include "feltmb/fiber/orientation.hpp"
#include "feltmb/numeric/chebyshev.hpp"
#include "feltmb/numeric/constants.hpp"
#include "feltmb/numeric/parallel.hpp"
#include "feltmb/numeric/roots.hpp"

namespace feltmb {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
using Values = std::map<std::string, double>;

/// Panels of a tenth of a natural logarithm of v: the structure varies on a length of one.
std::size_t panels_for(double v0) {
  return static_cast<std::size_t>(std::ceil(-10.0 * std::log(v0))) + 1;
}

/// P = scale (v^power - v0^power).
class PowerLaw final : public CompressionLaw {
 public:
  PowerLaw(double scale, int power, double v0)
      : CompressionLaw(v0, kInfinity), scale_(scale), power_(power), offset_(std::pow(v0, power)) {}

 protected:
  [[nodiscard]] double pressure_at(double v) const override {
    return scale_ * (std::pow(v, power_) - offset_);
  }
  [[nodiscard]] double slope_at(double v) const override {
    return scale_ * power_ * std::pow(v, power_ - 1);
  }
  [[nodiscard]] double energy_at(double v) const override {
    const int n = power_ - 1;
    return scale_ * ((std::pow(v, n) - std::pow(v0_, n)) / n + offset_ * (1.0 / v - 1.0 / v0_));
  }

 private:
  double scale_;
  int power_;
  double offset_;
};

/// P = scale v^3 / (1 - a v^3)^3 less its value at v0.
class ContactVolumeLaw final : public CompressionLaw {
 public:
  ContactVolumeLaw(double scale, double a, double v0)
      : CompressionLaw(v0, 1.0 / std::cbrt(a)), scale_(scale), a_(a) {
    offset_ = raw(v0);
    energy_offset_ = raw_energy(v0);
  }

 protected:
  [[nodiscard]] double pressure_at(double v) const override { return raw(v) - offset_; }
  [[nodiscard]] double slope_at(double v) const override {
    const double w = a_ * v * v * v;
    const double open = 1.0 - w;
    return 3.0 * scale_ * v * v * (1.0 + 2.0 * w) / (open * open * open * open);
  }
  [[nodiscard]] double energy_at(double v) const override {
    return raw_energy(v) - energy_offset_ - offset_ * (1.0 / v0_ - 1.0 / v);
  }

 private:
  [[nodiscard]] double raw(double v) const {
    const double x = v / (1.0 - a_ * v * v * v);
    return scale_ * x * x * x;
  }
  /// int v / (1 - a v^3)^3 dv by reduction to partial fractions, x = a^(1/3) v.
  [[nodiscard]] double raw_energy(double v) const {
    const double x = v * std::cbrt(a_);
    const double open = 1.0 - x * x * x;
    const double root3 = std::numbers::sqrt3;
    const double first = -std::log1p(-x) / 3.0 + std::log1p(x + x * x) / 6.0 -
                         (std::atan((2.0 * x + 1.0) / root3) - kPi / 6.0) / root3;
    const double second = (x * x / open + first) / 3.0;
    const double third = (x * x / (open * open) + 4.0 * second) / 6.0;
    return scale_ * third / std::pow(a_, 2.0 / 3.0);
  }
  double scale_, a_, offset_ = 0.0, energy_offset_ = 0.0;
};

/// Laws given by dP/dv = g(v): P and U from integrals in s = log v.
class IncrementalLaw : public CompressionLaw {
 protected:
  IncrementalLaw(double v0) : CompressionLaw(v0, kInfinity) {}

  /// @param rate  g(v) [Pa]
  template <class Rate>
  void build(Rate&& rate) {
    const double low = std::log(v0_);
    pressure_ = CumulativeIntegral(
        [&](double s) {
          const double v = std::exp(s);
          return v * rate(v);
        },
        low, 0.0, panels_for(v0_));
    energy_ = CumulativeIntegral([&](double s) { return pressure_.integral(s) / std::exp(s); }, low,
                                 0.0, panels_for(v0_));
  }
  [[nodiscard]] double pressure_at(double v) const override {
    return pressure_.integral(std::log(v));
  }
  [[nodiscard]] double slope_at(double v) const override {
    return pressure_.integrand(std::log(v)) / v;
  }
  [[nodiscard]] double energy_at(double v) const override { return energy_.integral(std::log(v)); }

  CumulativeIntegral pressure_, energy_;
};

/// (1 - exp(-a g)) / g, regular through g = 0 and for negative g.
double blocked_share(double a, double g) {
  const double x = a * g;
  return std::abs(x) < 1e-8 ? a * (1.0 - 0.5 * x) : -std::expm1(-x) / g;
}

class NarterLaw final : public IncrementalLaw {
 public:
  explicit NarterLaw(const Values& p) : IncrementalLaw(p.at("v_f0")) {
    const double scale = p.at("K_E") * p.at("E");
    const double gamma = p.at("gamma");
    const double q = p.at("Q");
    const double v_random = p.at("v_random");
    build([=](double v) {
      return scale * uniaxial_structure(v / v_random).cos4 * blocked_share(q * v, gamma);
    });
  }
};

class BendingChainLaw final : public IncrementalLaw {
 public:
  explicit BendingChainLaw(const Values& p) : IncrementalLaw(p.at("v_f0")) {
    const double scale = p.at("K_p") * p.at("E") / 32.0;
    const double gamma = p.at("gamma");
    const double q = p.at("Q");
    const double v_random = p.at("v_random");
    build([=](double v) {
      // Without v_random the orientation stays isotropic: K_3^2 / M_3 = 3/8.
      double structure = 0.375;
      if (!std::isnan(v_random)) {
        const UniaxialStructure s = uniaxial_structure(v / v_random);
        structure = s.K3 * s.K3 / s.M3;
      }
      const double share = blocked_share(q * v, gamma);
      return scale * structure * share * share;
    });
  }
};

/// d(P v)/dv = v g(v).
class AlkhagenTollLaw final : public CompressionLaw {
 public:
  explicit AlkhagenTollLaw(const Values& p) : CompressionLaw(p.at("v_f0"), kInfinity) {
    const double modulus = p.at("E");
    const double k_b = p.at("k_b");
    const double k_t = p.at("k_t");
    const double beta = p.at("beta");
    const double v_random = p.at("v_random");
    const double low = std::log(v0_);
    const auto rate = [=](double v) {
      const UniaxialStructure s = uniaxial_structure(v / v_random);
      const double fv = s.f * v;
      const double bending = 256.0 * k_b / std::pow(kPi, 4);
      // Bending and torsion in series; written so that k_t = 0 or k_b = 0 gives no crimp term.
      const double torsion = k_t / (kPi * kPi * fv * fv);
      const double both = torsion + bending / 3.0;
      const double crimp = both > 0.0 ? torsion * (bending / 3.0) / both : 0.0;
      return modulus * fv * fv * fv * fv * (bending * s.n3 + beta * beta * crimp * s.e3);
    };
    moment_ = CumulativeIntegral(
        [&](double s) {
          const double v = std::exp(s);
          return v * v * rate(v);
        },
        low, 0.0, panels_for(v0_));
    energy_ = CumulativeIntegral(
        [&](double s) {
          const double v = std::exp(s);
          return moment_.integral(s) / (v * v);
        },
        low, 0.0, panels_for(v0_));
  }

 protected:
  [[nodiscard]] double pressure_at(double v) const override {
    return moment_.integral(std::log(v)) / v;
  }
  [[nodiscard]] double slope_at(double v) const override {
    const double s = std::log(v);
    return (moment_.integrand(s) / v - moment_.integral(s) / v) / v;
  }
  [[nodiscard]] double energy_at(double v) const override { return energy_.integral(std::log(v)); }

 private:
  CumulativeIntegral moment_, energy_;
};

/// Eq. 3.64 in the form that does not cancel, less its value at v0.
class BinomialLaw final : public CompressionLaw {
 public:
  explicit BinomialLaw(const Values& p)
      : CompressionLaw(p.at("v_f0"), kInfinity), k_(p.at("K_p")), g_(p.at("Q") * p.at("gamma")) {
    offset_ = raw(v0_);
    energy_offset_ = raw_energy(v0_);
  }

 protected:
  [[nodiscard]] double pressure_at(double v) const override { return raw(v) - offset_; }
  [[nodiscard]] double slope_at(double v) const override {
    const double x = g_ * v;
    const double grown = std::expm1(x) / g_;
    const double bracket = 0.5 * std::exp(-x) + 1.5 - empty_share(x);
    double change;
    if (x < 1e-2) {
      change = -0.5 + x / 3.0 - x * x / 8.0 + x * x * x / 30.0 - x * x * x * x / 144.0;
    } else {
      change = (x * std::exp(-x) + std::expm1(-x)) / (x * x);
    }
    const double bracket_slope = -0.5 * std::exp(-x) - change;
    return k_ * grown * grown * (3.0 * std::exp(x) * bracket + grown * g_ * bracket_slope);
  }
  [[nodiscard]] double energy_at(double v) const override {
    return raw_energy(v) - energy_offset_ - offset_ * (1.0 / v0_ - 1.0 / v);
  }

 private:
  /// (1 - e^-x)/x.
  static double empty_share(double x) { return -std::expm1(-x) / x; }
  [[nodiscard]] double raw(double v) const {
    const double x = g_ * v;
    const double grown = std::expm1(x) / g_;
    return k_ * grown * grown * grown * (0.5 * std::exp(-x) + 1.5 - empty_share(x));
  }
  /// W/v with W of the energy identity P = v W' - W.
  [[nodiscard]] double raw_energy(double v) const {
    const double x = g_ * v;
    const double grown = std::expm1(x) / g_;
    return 0.5 * k_ * grown * grown * grown * empty_share(x) / v;
  }
  double k_, g_, offset_ = 0.0, energy_offset_ = 0.0;
};

class ArcLaw final : public CompressionLaw {
 public:
  explicit ArcLaw(const EnergyParams& params)
      : CompressionLaw(params.v_f0, kInfinity), params_(params) {
    validate(params_);
  }

 protected:
  [[nodiscard]] double pressure_at(double v) const override {
    return evaluate_energy(params_, v0_ / v, 1.0).pressure;
  }
  [[nodiscard]] double slope_at(double v) const override {
    // Fourth-order difference, one-sided at v0 where the law starts; relative error about 1e-8.
    const double h = 2e-4 * v;
    if (v - 2.0 * h > v0_) {
      return (8.0 * (pressure_at(v + h) - pressure_at(v - h)) - pressure_at(v + 2.0 * h) +
              pressure_at(v - 2.0 * h)) /
             (12.0 * h);
    }
    return (-25.0 * pressure_at(v) + 48.0 * pressure_at(v + h) - 36.0 * pressure_at(v + 2.0 * h) +
            16.0 * pressure_at(v + 3.0 * h) - 3.0 * pressure_at(v + 4.0 * h)) /
           (12.0 * h);
  }
  [[nodiscard]] double energy_at(double v) const override {
    const EnergyState s = evaluate_energy(params_, v0_ / v, 1.0);
    return s.bending + s.straightening + s.slipping;
  }

 private:
  EnergyParams params_;
};

/// Straight segments renewed in every increment: each increment starts with buckling, so that
/// P = 6 v (8 E f^2 v^2 / pi^2) <cos^2>, the onset stress of the energy method at fraction v.
class RenewedArcLaw final : public CompressionLaw {
 public:
  RenewedArcLaw(double modulus, double v0, double v_random)
      : CompressionLaw(v0, kInfinity), scale_(48.0 * modulus / (kPi * kPi)), v_random_(v_random) {
    offset_ = raw(v0);
    energy_ =
        CumulativeIntegral([&](double s) { return (raw(std::exp(s)) - offset_) / std::exp(s); },
                           std::log(v0), 0.0, panels_for(v0));
  }

 protected:
  [[nodiscard]] double pressure_at(double v) const override { return raw(v) - offset_; }
  [[nodiscard]] double slope_at(double v) const override {
    const double h = 1e-3 * v;
    return (8.0 * (raw(v + h) - raw(v - h)) - raw(v + 2.0 * h) + raw(v - 2.0 * h)) / (12.0 * h);
  }
  [[nodiscard]] double energy_at(double v) const override { return energy_.integral(std::log(v)); }

 private:
  [[nodiscard]] double raw(double v) const {
    const UniaxialStructure s = uniaxial_structure(v / v_random_);
    return scale_ * s.f * s.f * (1.0 - s.M3) * v * v * v;
  }
  double scale_, v_random_, offset_ = 0.0;
  CumulativeIntegral energy_;
};

std::vector<LawDescription> make_descriptions() {
  const LawParameter k_p{
      "k_p", "",
      kNaN,  0,
      1e6,   true,
      1e-6,  1e3,
      true,  "van Wyk's constant; 3/8 for clamped straight random fibers, 0.01 found"};
  const LawParameter modulus{"E",  "Pa", kNaN, 0,    1e15,
                             true, 1e6,  1e12, true, "Young's modulus of the fiber"};
  const LawParameter v_f0{"v_f0", "",   kNaN, 0,     1,
                          true,   1e-3, 0.9,  false, "volume fraction of zero pressure"};
  const LawParameter v_fm{
      "v_fm", "",   kNaN, 0,     1,
      true,   0.05, 1.0,  false, "volume fraction with all fiber in contacts (jamming)"};
  const LawParameter v_random{
      "v_random", "",   kNaN, 0,    10,
      true,       1e-3, 1.0,  true, "volume fraction at which the orientation was isotropic"};
  const LawParameter gamma{
      "gamma", "",   kNaN, 0,    1e3,
      true,    1e-2, 50.0, true, "blocked fiber length per contact over d_f (geometry: pi/2)"};
  const LawParameter q{
      "Q",  "",  2.0, 0,     4,
      true, 1.0, 3.0, false, "contact density constant, 8 f / pi: 2 isotropic, 1.62 planar"};
  std::vector<LawDescription> all;
  all.push_back({"van_wyk",
                 "van Wyk: bending of straight segments",
                 "thesis eq. 2.1; van Wyk 1946 [115]",
                 "low volume fraction; no friction, crimp or reorientation",
                 {k_p, modulus, v_f0}});
  all.push_back({"neckar",
                 "Neckar: contact volume excluded",
                 "thesis eqs. 2.4, 2.5; Neckar [73]",
                 "v_f < v_fm",
                 {k_p, modulus, v_f0, v_fm}});
  all.push_back({"stamm",
                 "Neckar with Stamm's free contact fraction w_f",
                 "thesis 2.2.1; Stamm [100] (judged reading: W/V = v^3/(v_fm^2 w_f))",
                 "v_f^3 < v_fm^2 w_f",
                 {k_p,
                  modulus,
                  v_f0,
                  v_fm,
                  {"w_f", "", kNaN, 0, 1, true, 0.05, 1.0, false,
                   "fiber volume over contact volume in the contacts; v_fm gives neckar"}}});
  all.push_back({"toll_planar",
                 "Toll and Manson: planar network",
                 "thesis eq. 2.8; Toll, Manson [111]",
                 "fibers in planes normal to the load",
                 {modulus,
                  v_f0,
                  {"f", "", 2.0 / kPi, 0, 1, true, 0.01, 2.0 / kPi, false,
                   "mean |e x e'|; 2/pi planar isotropic"}}});
  all.push_back(
      {"narter",
       "Narter: axial strain of bonded fibers, large compression",
       "thesis eqs. 3.16-3.27, 3.15; Narter et al. [72]",
       "no buckling or sliding; a negative gamma is accepted but unphysical",
       {modulus,
        v_f0,
        {"gamma", "", kNaN, -1e3, 1e3, false, -20.0, 50.0, false,
         "blocked fiber length per contact over d_f (> 0 physical)"},
        {"K_E", "", 1.0, 0, 1e6, true, 1e-6, 1e2, true, "uncertainty constant of eq. 3.27"},
        v_random,
        q}});
  all.push_back(
      {"alkhagen_toll",
       "Alkhagen and Toll: granular rate theory",
       "thesis eqs. 3.28-3.57; Alkhagen, Toll [1]",
       "beta^2 >> 1 for the crimp term; no slip",
       {modulus,
        v_f0,
        {"k_b", "", 1.0, 0, 1e9, false, 1e-6, 1e4, true,
         "bending constant; 1 clamped beam loaded at midspan"},
        {"k_t", "", 1.0, 0, 1e12, false, 1e-8, 1e6, true,
         "torsion constant; a simple bar is 2 for Poisson ratio 1/3; 0: no crimp term"},
        {"beta", "", 0.0, 0, 1e6, false, 0.1, 1e4, true, "crimp spacing over fiber radius"},
        v_random}});
  all.push_back({"binomial",
                 "Neckar and Das: binomial number of contacts",
                 "thesis eqs. 3.58-3.64; Neckar, Das [74]",
                 "isotropic fibers (Q = 2); grows as exp(3 Q gamma v), no jamming",
                 {{"K_p", "Pa", kNaN, 0, 1e18, true, 1.0, 1e14, true,
                   "scale; tends to k_p E of van Wyk at low fraction"},
                  gamma,
                  v_f0,
                  q}});
  all.push_back({"bending_chain",
                 "bending chain 3.58-3.63 with binomial contacts, literally",
                 "thesis eqs. 3.58-3.63, 3.74, 3.15",
                 "no blocked length in the bending volume, so softer than eq. 3.64",
                 {modulus,
                  gamma,
                  v_f0,
                  {"K_p", "", 24.0, 0, 1e6, true, 1e-4, 1e3, true,
                   "beam constant of eq. 3.74; 24 clamped, loaded at midspan"},
                  q,
                  {"v_random", "", kNaN, 0, 10, true, 1e-3, 1.0, true,
                   "isotropic fraction; not given: orientation stays isotropic"}}});
  all.push_back({"komori_itoh",
                 "Komori and Itoh: straight segments bent to arcs, confined",
                 "thesis 2.2.1; Komori, Itoh [47]",
                 "P(v_f0+) > 0 (buckling); contacts as at v_f0",
                 {modulus, v_f0}});
  all.push_back({"komori_itoh_renewed",
                 "Komori and Itoh with contacts renewed in every increment",
                 "thesis 2.2.1; Komori, Itoh [47] (judged reading)",
                 "straight segments; isotropic value E (v_f^3 - v_f0^3) without reorientation",
                 {modulus, v_f0, v_random}});
  all.push_back({"lee_carnaby",
                 "Lee and Carnaby: crimped segments bent to arcs, confined",
                 "thesis 2.2.1, eq. 2.6; Lee, Carnaby [56, 57]",
                 "contacts as at v_f0",
                 {modulus,
                  v_f0,
                  {"chord_ratio", "", kNaN, 0.05, 1.0, false, 0.1, 0.999, false,
                   "chord over arc length of a segment at rest"}}});
  return all;
}

}  // namespace

double CompressionLaw::volume_fraction(double target, double v_max) const {
  if (target <= 0.0) return v0_;
  const double top = pressure(v_max);
  if (!(target <= top)) {
    throw InvalidParameter(
        format("compression law: pressure = %.6g Pa, must be <= %.6g Pa (its value at v_f = %.6g)",
               target, top, v_max));
  }
  return find_root([&](double v) { return std::pair(pressure(v) - target, slope(v)); }, v0_, v_max);
}

const std::vector<LawDescription>& law_descriptions() {
  static const auto& all = *new std::vector<LawDescription>(make_descriptions());
  return all;
}

const LawDescription& law_description(const std::string& name) {
  std::string list;
  for (const LawDescription& law : law_descriptions()) {
    if (law.name == name) return law;
    list += (list.empty() ? "" : ", ") + law.name;
  }
  throw InvalidParameter("compression law: model = \"" + name + "\", must be one of " + list);
}

std::unique_ptr<const CompressionLaw> make_law(const std::string& name, const Values& parameters) {
  const LawDescription& description = law_description(name);
  Faults faults("compression law \"" + name + "\"");
  Values values;
  std::string known;
  for (const LawParameter& p : description.parameters) {
    known += (known.empty() ? "" : ", ") + p.name;
  }
  for (const auto& given : parameters) {
    const bool found = std::any_of(description.parameters.begin(), description.parameters.end(),
                                   [&](const LawParameter& p) { return p.name == given.first; });
    if (!found) {
      faults.add_text(format("unknown parameter \"%s\" = %.6g, expected only %s",
                             given.first.c_str(), given.second, known.c_str()));
    }
  }
  for (const LawParameter& p : description.parameters) {
    const auto found = parameters.find(p.name);
    if (found != parameters.end()) {
      const double value = found->second;
      const bool low_ok = p.low_open ? value > p.low : value >= p.low;
      if (!(low_ok && value <= p.high)) {
        faults.add(p.name.c_str(), value, p.unit.c_str(),
                   format("%s %.6g and <= %.6g", p.low_open ? ">" : ">=", p.low, p.high),
                   p.meaning);
      }
      values[p.name] = value;
    } else if (!std::isnan(p.default_value) || p.name == "v_random") {
      values[p.name] = p.default_value;
    } else {
      faults.add_text("parameter \"" + p.name + "\" is missing, expected a value" +
                      (p.unit.empty() ? "" : " in " + p.unit) + " (" + p.meaning + ")");
    }
  }
  faults.raise_if_any();
  const double v0 = values.at("v_f0");
  if (!(v0 < 1.0)) faults.add("v_f0", v0, "", "< 1");
  if (name != "bending_chain" && values.count("v_random") > 0 && std::isnan(values["v_random"])) {
    values["v_random"] = v0;
  }
  if (name == "neckar" || name == "stamm") {
    const double v_fm = values.at("v_fm");
    const double w_f = name == "stamm" ? values.at("w_f") : v_fm;
    const double limit = std::cbrt(v_fm * v_fm * w_f);
    if (!(limit > v0)) {
      faults.add("v_f0", v0, "",
                 format("< %.6g, where the contact volume fills the assembly", limit));
    }
    faults.raise_if_any();
    return std::make_unique<ContactVolumeLaw>(values.at("k_p") * values.at("E"),
                                              1.0 / (v_fm * v_fm * w_f), v0);
  }
  faults.raise_if_any();
  if (name == "van_wyk") {
    return std::make_unique<PowerLaw>(values.at("k_p") * values.at("E"), 3, v0);
  }
  if (name == "toll_planar") {
    const double f = values.at("f");
    return std::make_unique<PowerLaw>(
        512.0 / (5.0 * std::pow(kPi, 4)) * values.at("E") * std::pow(f, 4), 5, v0);
  }
  if (name == "narter") return std::make_unique<NarterLaw>(values);
  if (name == "alkhagen_toll") return std::make_unique<AlkhagenTollLaw>(values);
  if (name == "binomial") return std::make_unique<BinomialLaw>(values);
  if (name == "bending_chain") return std::make_unique<BendingChainLaw>(values);
  if (name == "komori_itoh_renewed") {
    return std::make_unique<RenewedArcLaw>(values.at("E"), v0, values.at("v_random"));
  }
  EnergyParams arcs{};
  arcs.E = values.at("E");
  arcs.v_f0 = v0;
  arcs.chord_ratio = name == "lee_carnaby" ? values.at("chord_ratio") : 1.0;
  return std::make_unique<ArcLaw>(arcs);
}

void evaluate_law(const CompressionLaw& law, LawQuantity quantity, std::span<const double> v,
                  std::span<double> out, std::size_t threads) {
  if (out.size() != v.size()) {
    throw InvalidParameter(
        format("compression law: output has %zu places, expected %zu", out.size(), v.size()));
  }
  Faults faults("compression law");
  std::size_t bad = 0;
  for (std::size_t i = 0; i < v.size(); ++i) {
    if (v[i] > 0.0 && v[i] <= 1.0 && v[i] < law.limit()) continue;
    if (++bad <= 5) {
      faults.add(format("v_f[%zu]", i).c_str(), v[i], "",
                 law.limit() <= 1.0 ? format("> 0 and < %.6g (jamming)", law.limit())
                                    : std::string("> 0 and <= 1"));
    }
  }
  if (bad > 5) faults.add_text(format("... and %zu more values of v_f out of range", bad - 5));
  faults.raise_if_any();
  // Small arrays are not worth a thread.
  const std::size_t useful = std::max<std::size_t>(1, v.size() / 2000);
  parallel_for(v.size(), std::min(resolve_threads(threads), useful),
               [&](std::size_t begin, std::size_t end) {
                 for (std::size_t i = begin; i < end; ++i) {
                   switch (quantity) {
                     case LawQuantity::pressure:
                       out[i] = law.pressure(v[i]);
                       break;
                     case LawQuantity::slope:
                       out[i] = law.slope(v[i]);
                       break;
                     case LawQuantity::energy:
                       out[i] = law.energy(v[i]);
                       break;
                   }
                 }
               });
}

}  // namespace feltmb
