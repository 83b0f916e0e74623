/// Places along a trajectory where the Jacobian, or the right-hand side itself, jumps.
#pragma once

#include <vector>

#include "feltmb/sensitivity/trajectory.hpp"
#include "shifted_models.hpp"

namespace feltmb::detail {

enum class SwitchKind {
  kStop,      ///< breakpoint of the input
  kClosing,   ///< a contact closes or opens
  kBranch,    ///< a contact law changes its smooth piece, or a strap its state
  kZone,      ///< the sliding speed of a contact or joint enters another zone of its friction
  kReversal,  ///< a felt with memory takes a new largest compression
  kMonitor,   ///< a monitored point passes its level
  kEnd,
};

struct Switch {
  double time = 0.0;  ///< on the clock of the trajectory [s]
  SwitchKind kind = SwitchKind::kEnd;
  int index = -1;     ///< contact, monitor, or number of the stop
  int direction = 0;  ///< +1 rising, -1 falling
};

/// All switches in the order of time, the end last.
std::vector<Switch> find_switches(Trajectory& trajectory, ShiftedModels& models,
                                  const SensitivityOptions& options, const InputSignal& input);

}  // namespace feltmb::detail
