// MechanismSystem::solve for many right-hand sides at once: rows of states, columns side by side.

#include "feltmb/core/index.hpp"
#include "feltmb/modal/kernels.hpp"
#include "feltmb/model/mechanism_system.hpp"

namespace feltmb {

void MechanismSystem::solve_many(RowBlock& b, const RowBlock* loads) {
  using Row = Eigen::RowVectorXd;
  const Eigen::Index columns = b.cols();
  const double g = gamma_;
  auto r_q = b.topRows(n_);
  auto r_v = b.middleRows(n_, n_);
  const Eigen::Index law = 2 * n_;
  const Eigen::Index eta = law + law_states_;
  // Strings that nothing touches may be left out of the rows: they are no part of the rest.
  const int modes = b.rows() == eta ? 0 : modes_;
  const Eigen::Index rate = eta + modes;

  for (int j = 0; j < modes; ++j) {
    const double factor = modal_rate_factor_[as_index(j)];
    b.row(rate + j) =
        factor * b.row(rate + j) - (factor * g * modal_stiffness_[as_index(j)]) * b.row(eta + j);
  }
  RowBlock& right = right_rows_;
  right.setZero(n_ + coupling_count_ + constraint_, columns);
  const auto width = static_cast<std::size_t>(columns);
  add_row_products(as_index(n_), mass_.data(), 1.0, r_v.data(), width, width, right.data(), width);
  const auto& stiffness = stateful_count_ > 0 ? stiffness_ : base_stiffness_;  // see factorize
  add_row_products(as_index(n_), stiffness.data(), g, r_q.data(), width, width, right.data(),
                   width);
  if (loads != nullptr) right.topRows(n_) += g * *loads;
  if (constraint_ > 0) {
    const Prescription& p = dynamics_.prescription();
    right.row(n_ + coupling_count_) =
        p.row.transpose() * r_v - g * (p.by_position.transpose() * r_q);
  }
  for (int i = 0; i < coupling_count_; ++i) {
    const StringCoupling& c = couplings_[as_index(i)];
    Row velocity = Row::Zero(columns);
    Row displacement = Row::Zero(columns);
    Row slope = Row::Zero(columns);
    for (int j = 0; j < c.count; ++j) {
      const int mode = c.offset + j;
      const double phi = phi_[as_index(c.shape + j)];
      velocity += phi * b.row(rate + mode);
      displacement += phi * b.row(eta + mode);
      slope += dphi_[as_index(c.shape + j)] * (b.row(eta + mode) + g * b.row(rate + mode));
    }
    displacement += g * velocity;
    for (int j = 0; j < coupling_count_; ++j) {
      const StringCoupling& other = couplings_[as_index(j)];
      if (other.string != c.string) continue;
      const modal::GramSums& a = c.to[as_index(j)];
      const Row shift = other.force * (other.strike.transpose() * r_q);
      velocity += (g * a.phi_dphi) * shift;
      displacement += (g * g * a.phi_dphi) * shift;
      slope += (g * g * a.dphi_dphi) * shift;
    }
    const Row speed = velocity + c.strike_speed * slope;
    right.topRows(n_) += g * (c.displacement_column * displacement) -
                         (g * c.by_rate) * (c.force_column * speed) +
                         (g * c.force) * (c.slope_force * slope);
    right.row(n_ + i) = c.by_compression * (c.gradient.transpose() * r_q - displacement) +
                        c.by_rate * (c.rate_gradient.transpose() * r_q - speed);
  }
  for (int i = 0; i < stateful_count_; ++i) {
    const StatefulContact& c = stateful_[as_index(i)];
    const Contact& contact = mechanism().contacts[as_index(c.contact)];
    const auto count = static_cast<Eigen::Index>(contact.law.n_states());
    auto own = b.middleRows(law + contact.first_state, count);
    own = (c.inverse.topLeftCorner(count, count) * own).eval();
    if (!c.closed) continue;
    Row force = Row::Zero(columns);
    for (Eigen::Index j = 0; j < count; ++j)
      force += c.states.force[static_cast<std::size_t>(j)] * own.row(j);
    right.topRows(n_) += g * (c.gradient->by_force * force);
    if (c.coupling >= 0) right.row(n_ + c.coupling) += force;
  }
  lu_.solve_rows(right.data(), width, width);
  r_q += g * right.topRows(n_);
  r_v = right.topRows(n_);
  for (int i = 0; i < coupling_count_; ++i) {
    const StringCoupling& c = couplings_[as_index(i)];
    const Row dforce = g * right.row(n_ + i);
    const Row shift = (g * c.force) * (c.strike.transpose() * r_q);  // r_q now holds dq
    for (int j = 0; j < c.count; ++j) {
      const double factor = modal_rate_factor_[as_index(c.offset + j)];
      b.row(rate + c.offset + j) += (factor * phi_[as_index(c.shape + j)]) * dforce +
                                    (factor * dphi_[as_index(c.shape + j)]) * shift;
    }
  }
  b.middleRows(eta, modes) += g * b.middleRows(rate, modes);

  for (int i = 0; i < stateful_count_; ++i) {
    const StatefulContact& c = stateful_[as_index(i)];
    if (!c.closed) continue;
    Row compression = c.gradient->compression.transpose() * r_q;
    Row speed = c.gradient->rate.transpose() * r_q;
    speed += c.gradient->compression.transpose() * r_v;
    if (c.coupling >= 0) {
      const StringCoupling& string = couplings_[as_index(c.coupling)];
      for (int j = 0; j < string.count; ++j) {
        const int mode = string.offset + j;
        const double phi = phi_[as_index(string.shape + j)];
        compression -= phi * b.row(eta + mode);
        speed -= phi * b.row(rate + mode) +
                 (string.strike_speed * dphi_[as_index(string.shape + j)]) * b.row(eta + mode);
      }
    }
    const Contact& contact = mechanism().contacts[as_index(c.contact)];
    const auto count = static_cast<Eigen::Index>(contact.law.n_states());
    auto own = b.middleRows(law + contact.first_state, count);
    own += c.by_compression.head(count) * compression + c.by_rate.head(count) * speed;
  }
}

}  // namespace feltmb
