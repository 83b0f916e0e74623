#include "free_columns.hpp"

#include <algorithm>

namespace feltmb::detail {
namespace {

modal::ModalResponse response_of(const Mechanism& m) {
  std::vector<double> stiffness, damping;
  for (const auto& s : m.strings) {
    stiffness.insert(stiffness.end(), s.string.stiffness().begin(), s.string.stiffness().end());
    damping.insert(damping.end(), s.string.damping().begin(), s.string.damping().end());
  }
  return {std::move(stiffness), std::move(damping), 1e-3};
}

}  // namespace

FreeColumns::FreeColumns(const ShiftedModels& models)
    : first_(models.first_mode()),
      modes_(models.modes()),
      response_(response_of(models.mechanism())) {
  for (std::size_t j = 0; j < models.parameters(); ++j) {
    if (!models.moves_strings(j)) continue;
    std::vector<Shifted> own;
    bool moves = false;
    for (std::size_t k = 0; k < models.nodes(j); ++k) {
      own.push_back(
          {static_cast<Eigen::Index>(j), models.weight(j, k), response_of(models.mechanism(j, k))});
      moves = moves || own.back().response.stiffness() != response_.stiffness() ||
              own.back().response.damping() != response_.damping();
    }
    if (!moves) continue;
    for (Shifted& each : own) shifted_.push_back(std::move(each));
  }
}

void FreeColumns::move(double step, std::span<const double> y, RowMatrix& columns) {
  if (modes_ == 0 || !(step > 0.0)) return;
  const auto eta = y.subspan(first_, modes_);
  const auto rate = y.subspan(first_ + modes_, modes_);
  const auto at_rest = [](double x) { return x == 0.0; };
  const bool still = std::all_of(eta.begin(), eta.end(), at_rest) &&
                     std::all_of(rate.begin(), rate.end(), at_rest);
  const auto top = static_cast<Eigen::Index>(first_);
  const auto count = static_cast<Eigen::Index>(modes_);
  // Before the first strike there is nothing to move.
  if (still && columns.middleRows(top, 2 * count).isZero(0.0)) return;
  const modal::StepResponse r = response_.over(step);
  const auto& k = response_.stiffness();
  const auto& d = response_.damping();
  for (Eigen::Index j = 0; j < count; ++j) {
    const auto i = static_cast<std::size_t>(j);
    const double* g = r.impulse.data();
    auto x = columns.row(top + j).array();
    auto v = columns.row(top + count + j).array();
    for (Eigen::Index c = 0; c < columns.cols(); ++c) {
      const double before = x[c];
      x[c] = (r.slope[i] + d[i] * g[i]) * before + g[i] * v[c];
      v[c] = -k[i] * g[i] * before + r.slope[i] * v[c];
    }
  }
  if (still) return;
  for (const Shifted& s : shifted_) {
    const modal::StepResponse own = s.response.over(step);
    for (Eigen::Index j = 0; j < count; ++j) {
      const auto i = static_cast<std::size_t>(j);
      const double g = own.impulse[i];
      const double slope = own.slope[i];
      columns(top + j, s.column) +=
          s.weight * ((slope + s.response.damping()[i] * g) * eta[i] + g * rate[i]);
      columns(top + count + j, s.column) +=
          s.weight * (slope * rate[i] - s.response.stiffness()[i] * g * eta[i]);
    }
  }
}

}  // namespace feltmb::detail
