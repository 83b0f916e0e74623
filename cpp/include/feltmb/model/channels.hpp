/// Output channels of a mechanism: one table for Python, files, plots and measured data.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "feltmb/model/mechanism_system.hpp"

namespace feltmb {

/// Input of a channel: a system evaluated at (t, y). Its mechanism may have other numbers than the
/// one for which the table was made; a channel only reads values from here.
struct ChannelView {
  MechanismSystem& system;
  double t;
  std::span<const double> y;
  std::span<const double> q;  ///< coordinates with the deflections of condensed ones

  const Mechanism& mechanism() const { return system.mechanism(); }
  Dynamics& dynamics() const { return system.dynamics(); }
};

/// One output, i.e. one row of the table.
struct Channel {
  std::string name;
  std::string unit;
  std::string text;
  std::function<double(const ChannelView&)> value;
  bool place = false;  ///< depends only on positions and speeds of the links
};

/// All outputs of a mechanism in their order: coordinates and their rates, tracking points,
/// contacts, straps, finger, motor, strings, energies. An output is added by one row in
/// channels.cpp, before the energies.
class Channels {
 public:
  /// The last outputs: stored energy, kinetic first [J].
  static constexpr int kStoredParts = 5;

  Channels() = default;
  explicit Channels(const Mechanism& mechanism);

  const std::vector<Channel>& rows() const { return rows_; }
  std::size_t size() const { return rows_.size(); }

  /// Values at (t, y); `out` has the length of rows().
  void observe(MechanismSystem& system, double t, std::span<const double> y,
               std::span<double> out) const;

  /// As `observe`, but only for outputs of positions: no force is evaluated.
  void observe_places(MechanismSystem& system, std::span<const double> y,
                      std::span<double> out) const;

 private:
  std::vector<Channel> rows_;
};

}  // namespace feltmb
