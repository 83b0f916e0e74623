/// All contact laws; a new law needs its header and its name here.
#pragma once

#include <variant>

#include "feltmb/contact/laws/callback.hpp"
#include "feltmb/contact/laws/dunlop.hpp"
#include "feltmb/contact/laws/exponential_pair.hpp"
#include "feltmb/contact/laws/expression.hpp"
#include "feltmb/contact/laws/felt_memory.hpp"
#include "feltmb/contact/laws/felt_return_point.hpp"
#include "feltmb/contact/laws/hunt_crossley.hpp"
#include "feltmb/contact/laws/kelvin_voigt.hpp"
#include "feltmb/contact/laws/lankarani_nikravesh.hpp"
#include "feltmb/contact/laws/maxwell.hpp"
#include "feltmb/contact/laws/mean_curve.hpp"
#include "feltmb/contact/laws/stulov.hpp"
#include "feltmb/contact/laws/stulov_differential.hpp"

namespace feltmb {

using LawParameters = std::variant<  //
    ExponentialPair,                 //
    MeanCurve,                       //
    HuntCrossley,                    //
    LankaraniNikravesh,              //
    KelvinVoigt,                     //
    Stulov,                          //
    StulovDifferential,              //
    Maxwell,                         //
    Dunlop,                          //
    FeltMemory,                      //
    FeltReturnPoint,                 //
    Expression,                      //
    Callback>;

}  // namespace feltmb
