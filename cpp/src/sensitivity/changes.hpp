/// What a parameter changes in a mechanism, found by comparing the shifted versions with it.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <vector>

#include "feltmb/sensitivity/sensitivity.hpp"

namespace feltmb::detail {

/// All that the versions of a mechanism with one parameter shifted have other than the mechanism
/// itself. Lists hold what differs; rates are a unit of the parameter.
struct Changes {
  struct OfContact {
    std::size_t contact;
    bool law = false;
    bool friction = false;
    bool geometry = false;
  };
  /// Mass, first moment and inertia of a link about its origin.
  struct OfLink {
    int link;
    double mass;
    Vec2 first;
    double second;
  };
  /// Elastic and damping matrices of a beam.
  struct OfBeam {
    int first;
    Eigen::MatrixXd stiffness, damping;
  };

  bool motions = false;  ///< links move otherwise: only the whole version tells what that does
  bool input = false;
  bool finger = false;   ///< place or direction of the finger
  bool strings = false;  ///< frequencies or damping of string modes
  bool shapes = false;   ///< shapes of string modes, or where a string lies
  bool points = false;   ///< where one looks
  Vec2 gravity;
  std::vector<OfContact> contacts;
  std::vector<OfLink> links;
  std::vector<OfBeam> beams;
  std::vector<std::size_t> joints;  ///< coordinates with another friction
  std::vector<std::size_t> springs, dashpots, straps;
  std::vector<double> mode_stiffness, mode_damping;  ///< of all strings; empty: no change

  /// Whether all of it is in `contacts`: where these are open nothing is changed.
  bool only_contacts() const;
};

/// Compares; `nodes` have the states of the mechanism.
Changes find_changes(const Mechanism& mechanism, const InputSignal& input,
                     const std::vector<Perturbed>& nodes);

}  // namespace feltmb::detail
