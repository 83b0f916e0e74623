/// All contact laws: a law is added by its header and a line here.
#pragma once

#include <variant>

#include "feltmb/contact/laws/exponential_pair.hpp"
#include "feltmb/contact/laws/felt_memory.hpp"
#include "feltmb/contact/laws/hunt_crossley.hpp"
#include "feltmb/contact/laws/mean_curve.hpp"
#include "feltmb/contact/laws/stulov.hpp"

namespace feltmb {

using LawParameters = std::variant<  //
    ExponentialPair,                 //
    MeanCurve,                       //
    HuntCrossley,                    //
    Stulov,                          //
    FeltMemory>;

}  // namespace feltmb
