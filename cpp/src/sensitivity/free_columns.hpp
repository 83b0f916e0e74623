/// Derivatives of strings that nothing touches.
#pragma once

#include <span>
#include <vector>

#include "feltmb/modal/response.hpp"
#include "shifted_models.hpp"

namespace feltmb::detail {

/// The rows of the strings in the columns of derivatives, moved exactly: with the modes y at the
/// start and R the rotation over a step, S+ = R S + (dR/dp) y.
class FreeColumns {
 public:
  explicit FreeColumns(const ShiftedModels& models);

  /// Moves the string rows of `columns` over `step` [s]; `y`: whole state at its start.
  void move(double step, std::span<const double> y, RowMatrix& columns);

 private:
  /// A string of a shifted model: its column, its weight in the difference formula.
  struct Shifted {
    Eigen::Index column;
    double weight;
    modal::ModalResponse response;
  };

  std::size_t first_;  ///< row of the first modal coordinate
  std::size_t modes_;
  modal::ModalResponse response_;
  std::vector<Shifted> shifted_;
};

}  // namespace feltmb::detail
