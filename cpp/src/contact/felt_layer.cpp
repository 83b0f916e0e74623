#include "feltmb/contact/felt_layer.hpp"

#include <algorithm>
#include <cmath>
#include <deque>
#include <map>
#include <mutex>
#include <utility>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/quadrature.hpp"
#include "monotone_table.hpp"

namespace feltmb {
namespace {

constexpr int kRows = 17;           // of a column table over the largest compression
constexpr std::size_t kPanels = 4;  // of an integral over columns

using Key = std::vector<double>;

/// Tables by the numbers, and the table of pressures, that they follow from.
class Cache {
 public:
  using Table = std::shared_ptr<const Envelope>;

  template <class Make>
  Table find(const Table& from, const Key& numbers, Make&& make) {
    const std::pair key{from.get(), numbers};
    {
      const std::lock_guard<std::mutex> guard(mutex_);
      if (const auto it = kept_.find(key); it != kept_.end()) return it->second.second;
    }
    // Two threads may make the same table; the first to come back is kept.
    const Table made = make();
    const std::lock_guard<std::mutex> guard(mutex_);
    // Keeping `from` keeps its address from being used again.
    const auto [it, added] = kept_.emplace(key, std::pair{from, made});
    const Table out = it->second.second;
    if (added) {
      order_.push_back(key);
      if (order_.size() > kLayerCache) {
        kept_.erase(order_.front());
        order_.pop_front();
      }
    }
    return out;
  }

 private:
  std::mutex mutex_;
  std::map<std::pair<const Envelope*, Key>, std::pair<Table, Table>> kept_;
  std::deque<std::pair<const Envelope*, Key>> order_;
};

Key key_of(const FeltMaterial& m) {
  return {m.mu, m.Wf0,         m.d_f,           m.v_f0,          m.v_f_max,
          m.Q,  m.loading.K_p, m.loading.gamma, m.unloading.K_p, m.unloading.gamma};
}

Key key_of(const FeltLayer& layer) {
  Key key{layer.thickness, layer.compression == LayerCompression::kColumns ? 1.0 : 0.0,
          static_cast<double>(layer.area.index())};
  const std::vector<double> own = numbers_of(layer.area);
  key.insert(key.end(), own.begin(), own.end());
  return key;
}

void check(const FeltLayer& layer) {
  if (!layer.pressure) throw InvalidParameter("felt layer: pressure is missing");
  validate(layer.area);
  if (!(std::isfinite(layer.thickness) && layer.thickness > 0.0)) {
    throw InvalidParameter(
        format("felt layer: thickness = %.6g m, must be finite and > 0", layer.thickness));
  }
}

/// Area of an indenter against t = sqrt(gap / depth), in which it is smooth, up to where it is
/// full.
class GapTable {
 public:
  GapTable(const ContactArea& area, double reach)
      : depth_(std::min(reach, full_area(area).compression)) {
    for (const double t : tables::knot_positions()) {
      area_.push_back(shared_area(area, depth_ * t * t));
    }
    slope_ = tables::smooth_slopes(area_);
  }

  /// Integral of pressure(e - g) dA(g) over 0 <= g <= e.
  template <class Pressure>
  double sum(double e, Pressure&& pressure) const {
    const double end = std::sqrt(std::min(1.0, e / depth_));
    return integrate_composite(
        [&](double t) {
          return pressure(std::max(0.0, e - depth_ * t * t)) *
                 tables::look_up(area_.data(), slope_.data(), t).slope;
        },
        0.0, end, kPanels);
  }

 private:
  double depth_;
  std::vector<double> area_, slope_;
};

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
  const auto& pressure = layer.pressure;
  const double h = layer.thickness;
  const ContactArea& area = layer.area;
  EnvelopeShape shape;
  shape.closing = h * pressure->closing();
  shape.reach = h * pressure->reach();
  const FullArea full = full_area(area);
  if (layer.compression == LayerCompression::kEven || full.compression == 0.0) {
    shape.loading = [&](double e) { return shared_area(area, e) * pressure->loading(e / h).force; };
    shape.ratio = [&](double x, double e_m) { return pressure->ratio(x, e_m / h).force; };
    return Envelope::from_shape(shape);
  }
  const GapTable indenter(area, shape.reach);
  const auto load = [&](double u) { return pressure->loading(u / h).force; };
  shape.rows = kRows;
  shape.loading = [&](double e) { return indenter.sum(e, load); };
  shape.ratio = [&](double x, double e_m) {
    const double e = x * e_m;
    const double whole = indenter.sum(e, load);
    if (!(whole > 0.0)) return 1.0;
    // Every column of a cycle lacks the same compression to its largest: e_m - e.
    const double lacking = e_m - e;
    const double back = indenter.sum(e, [&](double u) {
      const double reach = u + lacking;
      return reach > 0.0 ? load(u) * pressure->ratio(u / reach, reach / h).force : 0.0;
    });
    return std::clamp(back / whole, 0.0, 1.0);
  };
  return Envelope::from_shape(shape);
}

}  // namespace

std::shared_ptr<const Envelope> pressure_envelope(const FeltMaterial& material) {
  static Cache cache;
  return cache.find(nullptr, key_of(material), [&] { return make_pressure(material); });
}

std::shared_ptr<const Envelope> layer_envelope(const FeltLayer& layer) {
  static Cache cache;
  check(layer);
  return cache.find(layer.pressure, key_of(layer), [&] { return make_layer(layer); });
}

LayerColumns::LayerColumns(const FeltLayer& layer, int columns, double kappa)
    : thickness_(layer.thickness) {
  check(layer);
  law_ = std::make_shared<const ContactLaw>(FeltMemory{layer.pressure, kappa});
  if (columns < 1) {
    throw InvalidParameter(format("columns = %d, must be >= 1", columns));
  }
  const FullArea full = full_area(layer.area);
  const double end = thickness_ * layer.pressure->closing();
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
