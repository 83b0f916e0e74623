// Made by tools/make_bench_model.py from params/steinway45.toml. Do not edit.
// Hash of the parameters: d29e99c64bb0f009
// clang-format off
#pragma once

#include <map>

#include "feltmb/contact/felt_layer.hpp"
#include "feltmb/planar/description.hpp"

namespace feltmb::bench {

/// The packaged action; shank and wire flexible as packaged, or rigid.
inline MechanismDescription steinway45(bool flexible) {
  MechanismDescription d;
  d.name = "steinway45";
  d.gravity = {0.0, -9.81};
  d.bodies.push_back({"balance_slider", "ground", JointKind::kPrismatic,
                      {0.0, 0.0}, {0.0, 1.0}, 0.0,
                      "key.lift", {{0.0664, 0.0, 0.0, 1e-05}, {}, {}}, 0.0,
                      {0.0, 0.0}, 0.0, {}});
  d.bodies.push_back({"key", "balance_slider", JointKind::kRevolute,
                      {0.0, 0.0}, {0.0, 1.0}, 0.0,
                      "key.angle", {{0.0079, 0.0, 0.0, 0.0001}, {}, {}}, 0.1176,
                      {-0.0463, 0.0131}, 0.001741, {}});
  d.bodies.push_back({"whippen", "ground", JointKind::kRevolute,
                      {-0.178, 0.0489}, {0.0, 1.0}, 0.0,
                      "whippen.angle", {{0.000794, 0.0, 0.0, 0.0001}, {}, {}}, 0.009506,
                      {0.0293, 0.0070999999999999995}, 2.094e-05, {}});
  d.bodies.push_back({"jack", "whippen", JointKind::kRevolute,
                      {0.0338, 0.0145}, {0.0, 1.0}, 0.0,
                      "jack.angle", {{0.000397, 0.0, 0.0, 0.0001}, {}, {}}, 0.002883,
                      {0.0012, 0.0256}, 1.8919999999999998e-06, {}});
  d.bodies.push_back({"butt", "ground", JointKind::kRevolute,
                      {-0.17300000000000001, 0.131}, {0.0, 1.0}, 0.0,
                      "hammer.angle", {{0.0025, 0.0, 0.0, 0.0001}, {}, {}}, 0.00758,
                      {0.0127, 0.0134}, 2.7e-06, {}});
  d.bodies.push_back({"damper", "ground", JointKind::kRevolute,
                      {-0.196, 0.129}, {0.0, 1.0}, 0.0,
                      "damper.angle", {{0.0049, 0.0, 0.0, 0.0001}, {}, {}}, 0.01318,
                      {-0.004900000000000001, 0.039799999999999995}, 5.668e-05, {}});
  d.bodies.push_back({"wire", "whippen", JointKind::kWeld,
                      {0.0531, 0.0037}, {0.0, 1.0}, 1.3177235852557188,
                      "", {{0.0, 0.0, 0.0, 0.001}, {}, {}}, 0.0033020519399999996,
                      {0.033049999999999996, 0.0}, 1.2022798630639497e-06, {}});
  if (flexible) {
    auto& beam = d.bodies.back();
    beam.mass = 0.0;
    beam.center_of_mass = {};
    beam.inertia = 0.0;
    beam.beam = BeamDescription{0.06609999999999999, 0.0499554,
                                388752.54,
                                0.19737112695000003,
                                ShapeSet::kPolynomial, 1,
                                2, 0.0,
                                true};
  }
  d.bodies.push_back({"backcheck", "wire", JointKind::kWeld,
                      {0.06609999999999999, 0.0}, {0.0, 1.0}, 3.141592653589793,
                      "", {{0.0, 0.0, 0.0, 0.001}, {}, {}}, 0.001921,
                      {-0.014, -0.0014}, 1.76e-07, {}});
  d.bodies.push_back({"shank", "butt", JointKind::kWeld,
                      {0.0031000000000000003, 0.032}, {0.0, 1.0}, 1.5707963267948966,
                      "", {{0.0, 0.0, 0.0, 0.001}, {}, {}}, 0.0016635004673999998,
                      {0.0465, 0.0}, 1.19896796187855e-06, {}});
  if (flexible) {
    auto& beam = d.bodies.back();
    beam.mass = 0.0;
    beam.center_of_mass = {};
    beam.inertia = 0.0;
    beam.beam = BeamDescription{0.093, 0.0178871018,
                                321885.18,
                                0.6534332244000001,
                                ShapeSet::kPolynomial, 1,
                                2, 0.0,
                                true};
  }
  d.bodies.push_back({"head", "shank", JointKind::kWeld,
                      {0.093, 0.0}, {0.0, 1.0}, 0.0,
                      "", {{0.0, 0.0, 0.0, 0.001}, {}, {}}, 0.0078,
                      {0.0, 0.0369}, 3.1e-06, {}});
  d.surfaces.push_back({"Gp2", "ground", SurfaceKind::kCircle,
                        {-0.139, -0.388}, {0.0, 1.0}, 0.382,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Gp3", "ground", SurfaceKind::kCircle,
                        {0.218, -0.039394}, {0.0, 1.0}, 0.038,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Gp6", "ground", SurfaceKind::kLine,
                        {-0.223, 0.327}, {0.9999, 0.0106}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Gp8", "ground", SurfaceKind::kCircle,
                        {0.003, 0.151}, {0.0, 1.0}, 0.14200000000000002,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Gp9", "ground", SurfaceKind::kLine,
                        {-0.222, 0.232}, {0.9999, 0.0106}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Gp10", "ground", SurfaceKind::kLine,
                        {-0.133, 0.077}, {-0.0726, -0.9974}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Gp11", "ground", SurfaceKind::kCircle,
                        {-0.113, 0.112}, {0.0, 1.0}, 0.0307,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Gp12", "ground", SurfaceKind::kLine,
                        {0.0, 0.0}, {0.0, 1.0}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Kp1", "key", SurfaceKind::kCircle,
                        {0.0, 0.0}, {0.0, 1.0}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Kp2", "key", SurfaceKind::kCircle,
                        {-0.14100000000000001, 0.032600000000000004}, {0.0, 1.0}, 0.0079,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Kp3", "key", SurfaceKind::kLine,
                        {-0.149, 0.0}, {0.0, -1.0}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Kp4", "key", SurfaceKind::kLine,
                        {0.217, 0.0002859}, {0.0, -1.0}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Wp2", "whippen", SurfaceKind::kLine,
                        {0.0359, -0.0112}, {0.0, -1.0}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Wp3", "whippen", SurfaceKind::kCircle,
                        {-0.0079, 0.0296}, {0.0, 1.0}, 0.0048,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Bcp2", "backcheck", SurfaceKind::kConcave,
                        {-0.019100000000000002, -0.0887}, {0.0, 1.0}, 0.081,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Jp2", "jack", SurfaceKind::kHybrid,
                        {-0.0031000000000000003, 0.0685}, {0.0, 1.0}, 0.001,
                        {1.62, 3.148}});
  d.surfaces.push_back({"Jp3", "jack", SurfaceKind::kCircle,
                        {0.0131, 0.0054}, {0.0, 1.0}, 0.004,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Jp4", "jack", SurfaceKind::kCircle,
                        {-0.0031000000000000003, 0.0685}, {0.0, 1.0}, 0.001,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Jp5", "jack", SurfaceKind::kLine,
                        {0.0024, 0.0514}, {0.9996, 0.0272}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Hbp4", "butt", SurfaceKind::kCircle,
                        {0.0095, 0.0132}, {0.0, 1.0}, 0.0092,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Hbp5", "butt", SurfaceKind::kLine,
                        {0.0126, 0.003}, {0.9948, 0.1016}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Hbp6", "butt", SurfaceKind::kCircle,
                        {0.0448, 0.0156}, {0.0, 1.0}, 0.0050999999999999995,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Hbp7", "butt", SurfaceKind::kCircle,
                        {0.0492, 0.0217}, {0.0, 1.0}, 0.0005,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Hbp8", "butt", SurfaceKind::kCircle,
                        {0.0489, 0.027899999999999998}, {0.0, 1.0}, 0.0005,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Hp2", "head", SurfaceKind::kCircle,
                        {-0.0028, 0.0528}, {0.0, 1.0}, 0.0123,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Hsp3", "shank", SurfaceKind::kLine,
                        {0.0621, -0.0028}, {0.0, -1.0}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Dp2", "damper", SurfaceKind::kLine,
                        {0.0064, -0.051000000000000004}, {0.9974, 0.0723}, 0.0,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Dp3", "damper", SurfaceKind::kCircle,
                        {0.0136, 0.1041}, {0.0, 1.0}, 0.0439,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Gp13", "ground", SurfaceKind::kCircle,
                        {-0.17300000000000001, 0.252}, {0.0, 1.0}, 0.005,
                        {0.0, 0.0}});
  d.surfaces.push_back({"Dp4", "damper", SurfaceKind::kLine,
                        {0.004, 0.123}, {1.0, 0.0}, 0.0,
                        {0.0, 0.0}});
  d.contacts.push_back({1, "", "Gp2", "Kp3",
                        ExponentialPair{{5520.0, 1580.0, -600.0}, {190.0, 5040.0, 3040.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.0, 0.0, 0.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({2, "", "Gp3", "Kp4",
                        ExponentialPair{{2630.0, 1360.0, 800.0}, {7.8, 360.0, 210.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.0, 0.0, 0.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({3, "", "Kp2", "Wp2",
                        ExponentialPair{{27000.0, 1150.0, -22400.0}, {420.0, 5250.0, 2740.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.332, 0.73, 1.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({4, "", "Hbp4", "Jp2",
                        ExponentialPair{{17000.0, 15600.0, -4870.0}, {180.0, 43200.0, 15300.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.332, 0.73, 1.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({5, "", "Jp3", "Gp10",
                        ExponentialPair{{2620.0, 2960.0, -1150.0}, {30.0, 7990.0, 2480.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.434, 1.78, 1.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({6, "", "Hp2", "Gp6",
                        ExponentialPair{{23500.0, 1740.0, -24100.0}, {2000.0, 4520.0, -820.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.434, 1.78, 1.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({7, "", "Gp8", "Hsp3",
                        ExponentialPair{{140.0, 730.0, 180.0}, {2.8, 1610.0, 260.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.0, 0.0, 0.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({8, "", "Bcp2", "Hbp6",
                        ExponentialPair{{2420.0, 1590.0, -1160.0}, {120.0, 3620.0, 1360.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{1.085, 1.78, 1.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({9, "", "Wp3", "Dp2",
                        ExponentialPair{{70800.0, 100.0, -70300.0}, {5490.0, 940.0, -6380.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.332, 0.73, 1.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({10, "", "Dp3", "Gp9",
                        ExponentialPair{{280.0, 1000.0, 220.0}, {9.5, 2300.0, 330.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.0, 0.0, 0.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({11, "", "Jp4", "Hbp5",
                        ExponentialPair{{440.0, 1630.0, 500.0}, {10.0, 3550.0, 800.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.434, 1.78, 1.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({12, "", "Gp11", "Jp5",
                        ExponentialPair{{470.0, 1230.0, -90.0}, {30.0, 2770.0, 240.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.0, 0.0, 0.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({13, "", "Bcp2", "Hbp8",
                        ExponentialPair{{2620.0, 1840.0, -2370.0}, {120.0, 4130.0, 1120.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{1.085, 1.78, 1.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({14, "", "Bcp2", "Hbp7",
                        ExponentialPair{{2620.0, 1840.0, -2370.0}, {120.0, 4130.0, 1120.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{1.085, 1.78, 1.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({15, "", "Gp12", "Kp1",
                        ExponentialPair{{27000.0, 2640.0, -22710.0}, {3070.0, 6230.0, -2960.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.0, 0.0, 0.0, 0.001}, {}, {}}, true});
  d.contacts.push_back({16, "", "Gp13", "Dp4",
                        ExponentialPair{{280.0, 1000.0, 220.0}, {9.5, 2300.0, 330.0},
                                        100.0,
                                        ExponentialPair::Form::kGuarded},
                        {{0.0, 0.0, 0.0, 0.001}, {}, {}}, false});
  d.springs.push_back({"jack_spring", "jack.angle", 0.0069, 0.4});
  d.springs.push_back({"butt_spring", "hammer.angle", 0.00098, -2.8});
  d.springs.push_back({"damper_spring", "damper.angle", 0.0574, 0.7});
  d.straps.push_back({"bridle_strap", "whippen", {0.0698, 0.047299999999999995}, "butt",
                      {0.04020000000000001, 0.0112}, 0.0455,
                      {-63.45, 184000.0, 34700000.0}});
  d.strings.push_back({"string", "Gp6", false,
                       {0.00099, 654.0, 0.6315,
                        0.00598, 200000000000.0,
                        0.07, 40, 3},
                       0.0, {0.0, -1.0}, true, 0.0, {}});
  d.finger = FingerDescription{"key", {0.225, 0.0251}, {0.0, -1.0},
                               HuntCrossley{110000.0, 1.5, 1.0}};
  d.start_pose = {{"hammer.angle", -0.4}, {"jack.angle", 0.25}};
  return d;
}

/// Felt of every contact of steinway45_felt, by the number of the contact.
inline std::map<int, FeltLayer> felts() {
  std::map<int, FeltLayer> out;
  const auto add = [&](int number, const FeltMaterial& felt, double thickness,
                       const ContactArea& area) {
    out[number] = {pressure_envelope(felt), thickness, area,
                   LayerCompression::kEven};
  };
  add(1, {0.35, 0.171216779292, 2.4999999999999998e-05, 0.132, 0.21970179771712192, 2.0,
          {2869671.011724972, 1.5707963267948966}, {212024.62422923863, 4.615603871031102}},
      0.002319315, CircleOnLayer{0.382, 0.013000000000000001, 0.02});
  add(2, {0.35, 2.27442286941, 2.4999999999999998e-05, 0.132, 0.2970187872661105, 2.0,
          {6846365.007374707, 1.5707963267948966}, {221689.55614384808, 4.4734835077781865}},
      0.004679763000000001, CircleOnLayer{0.038, 0.013000000000000001, 0.022});
  add(3, {0.35, 1.70839520584, 2.4999999999999998e-05, 0.132, 0.19472917618627972, 2.0,
          {47519950.80201171, 1.5707963267948966}, {214687.3327764275, 8.288329569827086}},
      0.002856734, CircleOnLayer{0.0079, 0.009000000000000001});
  add(4, {0.35, 8.92000511464, 2.4999999999999998e-05, 0.183, 0.3170880436013627, 2.0,
          {25112520.072207388, 1.5707963267948966}, {622358.2114016651, 4.450431157338872}},
      0.000381019, CircleOnLayer{0.0009019607843137256, 0.008});
  add(5, {0.35, 1.82361594501, 2.4999999999999998e-05, 0.132, 0.24546682788143553, 2.0,
          {14437245.666347656, 1.5707963267948966}, {699327.5047933606, 4.729493300700611}},
      0.00187385, CircleOnLayer{0.004, 0.008});
  add(6, {0.35, 9.77034482286, 2.4999999999999998e-05, 0.389, 0.5315591867604944, 2.0,
          {2634742.7175495457, 1.5707963267948966}, {78184.8046875789, 3.109169001531639}},
      0.002910293, CrossedCylinders{0.0123, 0.000495});
  add(7, {0.35, 0.354558681191, 2.4999999999999998e-05, 0.132, 0.28092940233418795, 2.0,
          {1475020.433505111, 1.5707963267948966}, {185496.51294669523, 3.493675891058047}},
      0.008336426, CircleOnLayer{0.14200000000000002, 0.006, 0.02});
  add(8, {0.35, 0.768383522633, 2.4999999999999998e-05, 0.183, 0.3101859012194097, 2.0,
          {2514922.8691913886, 1.5707963267948966}, {220925.1019270727, 3.5659099592050065}},
      0.0034712930000000003, CircleOnLayer{0.005442687747035572, 0.012});
  add(9, {0.35, 0.455685697392, 2.4999999999999998e-05, 0.132, 0.17589986362221624, 2.0,
          {22677278.436026014, 1.5707963267948966}, {2068585.468579356, 5.034984468693573}},
      0.004198925, CircleOnLayer{0.0048, 0.007});
  add(10, {0.35, 0.320658374459, 2.4999999999999998e-05, 0.086, 0.15376914806771516, 2.0,
          {15647347.03282058, 1.5707963267948966}, {827488.4145498752, 6.618284027913806}},
      0.005852764, CircleOnLayer{0.0439, 0.003});
  add(11, {0.35, 3.54887074652, 2.4999999999999998e-05, 0.132, 0.27967387619176887, 2.0,
          {15053407.742489984, 1.5707963267948966}, {2061616.554165843, 3.4295239496683405}},
      0.003704541, CircleOnLayer{0.001, 0.008});
  add(12, {0.35, 0.098951336124, 2.4999999999999998e-05, 0.132, 0.2194941911688163, 2.0,
          {1395200.731711112, 1.5707963267948966}, {96934.60237729546, 4.718261767369156}},
      0.004340032, CircleOnLayer{0.030699999999999998, 0.008});
  add(13, {0.35, 5.77624309192, 2.4999999999999998e-05, 0.183, 0.35832769367992673, 2.0,
          {9330979.429476328, 1.5707963267948966}, {2123677.584944466, 2.6305978586171603}},
      0.002633291, CircleOnLayer{0.0005031055900621118, 0.012});
  add(14, {0.35, 5.77624309192, 2.4999999999999998e-05, 0.183, 0.35832769367992673, 2.0,
          {9330979.429476328, 1.5707963267948966}, {2123677.584944466, 2.6305978586171603}},
      0.002633291, CircleOnLayer{0.0005031055900621118, 0.012});
  add(15, {0.35, 0.425849557617, 2.4999999999999998e-05, 0.132, 0.24373440753501407, 2.0,
          {4314144.801094733, 1.5707963267948966}, {1001884.6157592038, 3.159063588757011}},
      0.001208224, ConstantArea{0.00026});
  add(16, {0.35, 0.320658374459, 2.4999999999999998e-05, 0.086, 0.15376914806771516, 2.0,
          {15647347.03282058, 1.5707963267948966}, {827488.4145498752, 6.618284027913806}},
      0.005852764, CircleOnLayer{0.005, 0.003});
  return out;
}

}  // namespace feltmb::bench
