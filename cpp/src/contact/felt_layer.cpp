#include "feltmb/contact/felt_layer.hpp"

#include <algorithm>
#include <cmath>
#include <deque>
#include <map>
#include <mutex>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {
namespace {

constexpr int kRows = 24;           // of a column table over the largest compression
constexpr std::size_t kPanels = 6;  // of an integral over columns

using Key = std::vector<double>;

/// Tables by the numbers that they follow from.
class Cache {
 public:
  template <class Make>
  std::shared_ptr<const Envelope> find(const Key& key, Make&& make) {
    {
      const std::lock_guard<std::mutex> guard(mutex_);
      if (const auto it = kept_.find(key); it != kept_.end()) return it->second;
    }
    // Two threads may make the same table; the first to come back is kept.
    const std::shared_ptr<const Envelope> made = make();
    const std::lock_guard<std::mutex> guard(mutex_);
    const auto [it, added] = kept_.emplace(key, made);
    if (added) {
      order_.push_back(key);
      if (order_.size() > kLayerCache) {
        kept_.erase(order_.front());
        order_.pop_front();
      }
    }
    return it->second;
  }

 private:
  std::mutex mutex_;
  std::map<Key, std::shared_ptr<const Envelope>> kept_;
  std::deque<Key> order_;
};

Key key_of(const FeltMaterial& m) {
  return {m.mu, m.Wf0,         m.d_f,           m.v_f0,          m.v_f_max,
          m.Q,  m.loading.K_p, m.loading.gamma, m.unloading.K_p, m.unloading.gamma};
}

Key key_of(const FeltLayer& layer) {
  Key key = key_of(layer.material);
  key.push_back(layer.thickness);
  key.push_back(layer.compression == LayerCompression::kColumns ? 1.0 : 0.0);
  key.push_back(static_cast<double>(layer.area.index()));
  if (const auto* flat = std::get_if<ConstantArea>(&layer.area)) {
    key.insert(key.end(), {flat->size, 0.0, 0.0});
  } else if (const auto* pair = std::get_if<CrossedCylinders>(&layer.area)) {
    key.insert(key.end(), {pair->radius_a, pair->radius_b, 0.0});
  } else if (const auto* circle = std::get_if<CircleOnLayer>(&layer.area)) {
    key.insert(key.end(), {circle->radius, circle->width, circle->length});
  } else {
    key.insert(key.end(), {std::get<SphereOnLayer>(layer.area).radius, 0.0, 0.0});
  }
  return key;
}

void check(const FeltLayer& layer) {
  validate(layer.material, "felt");
  validate(layer.area);
  if (!(std::isfinite(layer.thickness) && layer.thickness > 0.0)) {
    throw InvalidParameter(
        format("felt layer: thickness = %.6g m, must be finite and > 0", layer.thickness));
  }
}

/// Integral of p'(u) A(e - u) du over 0 <= u <= e, which is that of p(e - g) dA(g) by parts.
/// `slope(u)` is p'(u), `value(u)` is p(u).
template <class Value, class Slope>
double sum_columns(const ContactArea& area, const FullArea& full, double e, Value&& value,
                   Slope&& slope) {
  const double depth = std::min(e, full.compression);
  // Columns deeper than the indenter is high: all of its area presses.
  double sum = e > full.compression ? full.size * value(e - full.compression) : 0.0;
  if (depth <= 0.0) return sum;
  // u = e - depth t^2: the area begins as a root of the gap.
  return sum + integrate_composite(
                   [&](double t) {
                     const double g = depth * t * t;
                     return slope(e - g) * shared_area(area, g) * 2.0 * t * depth;
                   },
                   0.0, 1.0, kPanels);
}

std::shared_ptr<const Envelope> make_pressure(const FeltMaterial& m) {
  const FeltPressure pressure(m);
  const auto fraction = [&](double strain) { return m.v_f0 / (1.0 - strain); };
  EnvelopeShape shape;
  shape.closing = 1.0 - m.v_f0 / m.v_f_max;
  shape.reach = 1.0 - m.v_f0 / (0.5 * (1.0 + m.v_f_max));
  shape.loading = [&](double strain) { return pressure.loading(fraction(strain)); };
  shape.ratio = [&](double x, double strain) {
    // The ratio of two small pressures: from a compression that has one.
    const double v = fraction(std::max(x, 1e-4) * strain);
    const double load = pressure.loading(v);
    return load > 0.0 ? std::clamp(pressure.unloading(v) / load, 0.0, 1.0) : 1.0;
  };
  return Envelope::from_shape(shape);
}

std::shared_ptr<const Envelope> make_layer(const FeltLayer& layer) {
  const auto pressure = pressure_envelope(layer.material);
  const double h = layer.thickness;
  const ContactArea& area = layer.area;
  EnvelopeShape shape;
  shape.closing = h * pressure->closing();
  shape.reach = h * (1.0 - layer.material.v_f0 / (0.5 * (1.0 + layer.material.v_f_max)));
  const FullArea full = full_area(area);
  if (layer.compression == LayerCompression::kEven || full.compression == 0.0) {
    shape.loading = [&](double e) { return shared_area(area, e) * pressure->loading(e / h).force; };
    shape.ratio = [&](double x, double e_m) { return pressure->ratio(x, e_m / h).force; };
    return Envelope::from_shape(shape);
  }
  shape.rows = kRows;
  shape.loading = [&](double e) {
    return sum_columns(
        area, full, e, [&](double u) { return pressure->loading(u / h).force; },
        [&](double u) { return pressure->loading(u / h).slope / h; });
  };
  shape.ratio = [&](double x, double e_m) {
    const double e = x * e_m;
    const double load = shape.loading(e);
    if (!(load > 0.0)) return 1.0;
    // Every column of a cycle lacks the same compression to its largest: e_m - e.
    const double lacking = e_m - e;
    const auto ratio = [&](double u) { return pressure->ratio(u / (u + lacking), 1.0); };
    const double back = sum_columns(
        area, full, e, [&](double u) { return pressure->loading(u / h).force * ratio(u).force; },
        [&](double u) {
          const CurveValue p = pressure->loading(u / h);
          const CurveValue rho = ratio(u);
          const double reach = u + lacking;
          return p.slope / h * rho.force + p.force * rho.slope * lacking / (reach * reach);
        });
    return std::clamp(back / load, 0.0, 1.0);
  };
  return Envelope::from_shape(shape);
}

}  // namespace

std::shared_ptr<const Envelope> pressure_envelope(const FeltMaterial& material) {
  static Cache cache;
  return cache.find(key_of(material), [&] { return make_pressure(material); });
}

std::shared_ptr<const Envelope> layer_envelope(const FeltLayer& layer) {
  static Cache cache;
  check(layer);
  return cache.find(key_of(layer), [&] { return make_layer(layer); });
}

LayerColumns::LayerColumns(const FeltLayer& layer, int columns, double kappa)
    : thickness_(layer.thickness) {
  check(layer);
  law_ = std::make_shared<const ContactLaw>(FeltMemory{pressure_envelope(layer.material), kappa});
  if (columns < 1) {
    throw InvalidParameter(format("columns = %d, must be >= 1", columns));
  }
  const FullArea full = full_area(layer.area);
  const double end = thickness_ * pressure_envelope(layer.material)->closing();
  const double depth =
      layer.compression == LayerCompression::kEven ? 0.0 : std::min(end, full.compression);
  if (depth == 0.0) {
    gap_ = {0.0};
    area_ = {full.size};
    if (layer.compression == LayerCompression::kEven && full.compression > 0.0) {
      throw InvalidParameter(
          "columns: an even layer of growing area has no columns; expected compression = columns");
    }
  } else {
    // Rings of the indenter between gaps that grow as t^2, each at the middle of its area.
    double before = 0.0;
    for (int i = 0; i < columns; ++i) {
      const double t = (i + 0.5) / columns;
      const double outer = (i + 1.0) / columns;
      const double now = shared_area(layer.area, depth * outer * outer);
      gap_.push_back(depth * t * t);
      area_.push_back(now - before);
      before = now;
    }
  }
  for (std::size_t i = 0; i < gap_.size(); ++i) path_.emplace_back(*law_);
}

double LayerColumns::step(double e) {
  double sum = 0.0;
  for (std::size_t i = 0; i < gap_.size(); ++i) {
    // Of no duration: the law of a column is one of its path alone.
    sum += area_[i] * path_[i].step((e - gap_[i]) / thickness_, 1.0);
  }
  return sum;
}

void LayerColumns::reset() {
  for (auto& path : path_) path.reset();
}

}  // namespace feltmb
