#pragma once

#include "feltmb/contact/law.hpp"

namespace feltmb {

/// @throws InvalidParameter naming every number of a law that is out of range.
void check_law(const LawParameters& parameters);

}  // namespace feltmb
