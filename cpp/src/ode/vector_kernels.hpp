/// N_Vector of SUNDIALS with kernels of our own: the distribution's serial kernels are not
/// vectorised and took more than half of a step with a few hundred states.
#pragma once

#include <nvector/nvector_serial.h>

namespace feltmb::detail {

/// A serial vector that owns `size` doubles and carries our kernels; clones inherit them.
/// Returns nullptr when memory is short.
N_Vector make_vector(sunindextype size, SUNContext context);

}  // namespace feltmb::detail
