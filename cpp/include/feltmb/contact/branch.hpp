/// Smooth pieces of the contact laws.
#pragma once

#include "feltmb/contact/law.hpp"

namespace feltmb {

/// Number of the smooth piece of a law at compression [m] and rate [m/s]: where it changes, the
/// slopes of the force jump, though not the force. 0: no force and no rate of a state. Derivatives
/// along a motion have to stop there (a step over a change of slope is wrong in first order).
int branch(const ContactLaw& law, double compression, double rate, const LawMemory& memory = {});

}  // namespace feltmb
