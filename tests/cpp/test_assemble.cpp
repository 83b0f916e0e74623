// What assemble() refuses, all faults in one message, and how it merges welded bodies.
#include <doctest/doctest.h>

#include <cmath>
#include <string>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/planar/dynamics.hpp"

namespace {

using namespace feltmb;

BodyDescription body(const std::string& name, const std::string& parent = "ground") {
  BodyDescription b;
  b.name = name;
  b.parent = parent;
  b.coordinate = name + ".angle";
  b.mass = 0.1;
  b.center_of_mass = {0.1, 0.0};
  b.inertia = 1e-4;
  return b;
}

SurfaceDescription circle(const std::string& name, const std::string& on, double radius = 0.01) {
  SurfaceDescription s;
  s.name = name;
  s.body = on;
  s.radius = radius;
  return s;
}

SurfaceDescription line(const std::string& name, const std::string& on) {
  SurfaceDescription s;
  s.name = name;
  s.body = on;
  s.kind = SurfaceKind::kLine;
  return s;
}

ContactDescription contact(int number, const std::string& a, const std::string& b) {
  ContactDescription c;
  c.number = number;
  c.surface_a = a;
  c.surface_b = b;
  c.law = HuntCrossley{1e4, 1.5, 0.0};
  return c;
}

/// One lever over a stop, without fault.
MechanismDescription good() {
  MechanismDescription d;
  d.name = "lever";
  d.bodies = {body("lever")};
  d.surfaces = {circle("nose", "lever"), line("stop", "ground")};
  d.contacts = {contact(1, "nose", "stop")};
  return d;
}

std::string message_of(const MechanismDescription& d) {
  try {
    assemble(d);
  } catch (const InvalidParameter& error) {
    return error.what();
  }
  return "";
}

void check_fault(const MechanismDescription& d, const std::string& text) {
  const std::string message = message_of(d);
  INFO(message);
  CHECK(message.find(text) != std::string::npos);
  CHECK(message.starts_with("mechanism \"lever\": "));
}

}  // namespace

TEST_CASE("a mechanism without fault assembles") {
  const auto m = assemble(good());
  CHECK(m->size() == 1);
  CHECK(m->coordinates == std::vector<std::string>{"lever.angle"});
  CHECK(m->contact_index(1) == 0);
  CHECK(m->contact_index(7) == -1);
  CHECK(m->contacts[0].name == "contact01");
  CHECK(m->contacts[0].swapped);
}

TEST_CASE("each fault has a message that says where, what was got and what is expected") {
  auto d = good();
  d.bodies[0].mass = -1.0;
  check_fault(d, "body \"lever\": mass = -1 kg, must be >= 0");

  d = good();
  d.bodies[0].inertia = NAN;
  check_fault(d, "body \"lever\": inertia = nan kg m^2");

  d = good();
  d.bodies[0].friction.threshold_speed = 0.0;
  check_fault(d, "body \"lever\": friction threshold_speed = 0 rad/s, must be > 0");

  d = good();
  d.bodies.push_back(body("lever"));
  d.bodies.back().coordinate = "other";
  check_fault(d, "body \"lever\": the name is given twice");

  d = good();
  d.bodies.push_back(body("second"));
  d.bodies.back().coordinate = "lever.angle";
  check_fault(d, "coordinate \"lever.angle\" is given twice");

  d = good();
  d.bodies.push_back(body("second"));
  d.bodies.back().coordinate = "";
  check_fault(d, "body \"second\": its joint coordinate has no name");

  d = good();
  d.bodies.push_back(body("second", "nobody"));
  check_fault(d, "body \"second\": parent \"nobody\" is missing");

  d = good();
  d.bodies.push_back(body("second"));
  d.bodies.back().joint = JointKind::kPrismatic;
  d.bodies.back().axis = {0.0, 0.5};
  check_fault(d, "axis has length 0.5, must be 1");
  d.bodies.back().axis = {std::nan(""), 1.0};
  check_fault(d, "axis has length nan, must be 1");

  d = good();
  d.surfaces[0].body = "leever";
  check_fault(d, "surface \"nose\": body \"leever\" is missing; bodies are ground, lever");

  d = good();
  d.surfaces[1].normal = {0.0, 0.9};
  check_fault(d, "normal has length 0.9, must be 1");
  d.surfaces[1].normal = {0.0, std::nan("")};
  check_fault(d, "normal has length nan, must be 1");

  d = good();
  d.surfaces[1].kind = SurfaceKind::kSegment;
  d.surfaces[1].end = d.surfaces[1].point;
  check_fault(d, "is 0 m long from point to end, must be finite and > 1e-9 m");
  d.surfaces[1].end.y = 1e200;
  check_fault(d, "is inf m long");

  d = good();
  d.surfaces[0].radius = -1.0;
  check_fault(d, "radius = -1 m, must be >= 0");

  d = good();
  d.contacts[0].surface_b = "stopp";
  check_fault(d, "contact 01: surface \"stopp\" is missing; surfaces are nose, stop");

  d = good();
  d.contacts.push_back(contact(1, "nose", "stop"));
  check_fault(d, "contact 01: the number is given twice");

  d = good();
  d.surfaces.push_back(line("edge", "lever"));
  d.contacts[0].surface_a = "edge";
  check_fault(d, "one of the pair must be a circle");

  d = good();
  d.contacts[0].law = HuntCrossley{0.0, 1.5, 0.0};
  check_fault(d, "contact 01: stiffness [N/m^p] = 0, must be > 0");

  d = good();
  d.surfaces.push_back(circle("other", "lever"));
  d.contacts[0].surface_b = "other";
  check_fault(d, "belong to bodies that cannot move against each other");

  d = good();
  d.springs.push_back({"return", "lever.angel", 1.0, 0.0});
  check_fault(d, "spring \"return\": coordinate \"lever.angel\" is missing; coordinates are lever");

  d = good();
  d.straps.push_back({"strap", "lever", {}, "ground", {}, 0.0, {1.0, 0.0, 0.0}});
  check_fault(d, "free_length = 0 m, must be > 0");

  d = good();
  d.points.push_back({"tip", "nobody", {}});
  check_fault(d, "tracking point \"tip\": body \"nobody\" is missing");

  d = good();
  d.start_pose = {{"lever.angle", INFINITY}};
  check_fault(d, "start_pose: lever.angle is not a finite number");

  d = good();
  d.finger = FingerDescription{"ground", {}, {0.0, -1.0}, HuntCrossley{1.0, 1.0, 0.0}};
  check_fault(d, "finger: its point is fixed to the ground");

  d = good();
  d.strings.push_back({});
  d.strings[0].surface = "nose";
  check_fault(d, "surface \"nose\" must be a line of the ground");

  d = good();
  d.strings.push_back({});
  d.strings[0].surface = "stop";
  d.strings[0].other_surfaces = {"nose", "nowhere"};
  check_fault(d, "surface \"nose\" must be a line of the ground");
  check_fault(d, "surface \"nowhere\" must be a line of the ground");
}

TEST_CASE("a loop of parents is told from a missing parent") {
  auto d = good();
  d.bodies.push_back(body("a", "b"));
  d.bodies.push_back(body("b", "a"));
  const std::string message = message_of(d);
  CHECK(message.find("2 faults") != std::string::npos);
  CHECK(message.find("body \"a\": its chain of parents (b, ...) never reaches the ground") !=
        std::string::npos);
}

TEST_CASE("all faults are listed at once") {
  auto d = good();
  d.bodies[0].mass = -1.0;
  d.surfaces[0].radius = NAN;
  d.contacts[0].surface_b = "nothing";
  d.springs.push_back({"spring", "nothing", -1.0, NAN});
  d.points.push_back({"tip", "nothing", {}});
  const std::string message = message_of(d);
  INFO(message);
  CHECK(message.find("7 faults") != std::string::npos);
}

TEST_CASE("a coordinate that moves no mass is refused, a massless slider with a load is not") {
  auto d = good();
  d.bodies[0].mass = 0.0;
  d.bodies[0].inertia = 0.0;
  check_fault(d, "coordinate \"lever.angle\" moves no mass");

  d = good();
  BodyDescription slider = body("slider");
  slider.joint = JointKind::kPrismatic;
  slider.mass = slider.inertia = 0.0;
  d.bodies = {slider, body("lever", "slider")};
  CHECK(message_of(d).empty());
}

TEST_CASE("a strap that would push somewhere beyond slack is refused") {
  auto d = good();
  const auto with = [&](std::array<double, 3> k) {
    d.straps = {{"strap", "lever", {0.1, 0.0}, "ground", {}, 0.05, k}};
    return message_of(d);
  };
  CHECK(with({-63.45, 1.84e5, 3.47e7}).empty());  // the bridle strap: slack up to 0.34 mm
  CHECK(with({100.0, 0.0, 0.0}).empty());
  CHECK(!with({0.0, 0.0, 0.0}).empty());
  CHECK(!with({0.0, 0.0, -1.0}).empty());
  CHECK(!with({100.0, -1e6, 0.0}).empty());
  CHECK(!with({100.0, -1e6, 1e6}).empty());
  CHECK(!with({NAN, 1.0, 1.0}).empty());
}

TEST_CASE("welded bodies give the link of one body with their joint mass properties") {
  MechanismDescription d;
  d.name = "hammer";
  auto butt = body("butt");
  auto head = body("head", "butt");
  head.joint = JointKind::kWeld;
  head.coordinate = "";
  head.position = {0.05, 0.2};
  head.angle = 0.5;
  head.mass = 0.3;
  head.center_of_mass = {0.01, 0.04};
  d.bodies = {butt, head};
  const auto m = assemble(d);
  REQUIRE(m->links.size() == 2);
  const auto& link = m->links[1];
  const Vec2 center{0.05 + std::cos(0.5) * 0.01 - std::sin(0.5) * 0.04,
                    0.2 + std::sin(0.5) * 0.01 + std::cos(0.5) * 0.04};
  CHECK(link.mass == doctest::Approx(0.4));
  CHECK(link.center_of_mass.x == doctest::Approx((0.1 * 0.1 + 0.3 * center.x) / 0.4));
  CHECK(link.center_of_mass.y == doctest::Approx(0.3 * center.y / 0.4));
  // About the pivot the moments of inertia add.
  const double about_pivot =
      link.inertia + link.mass * dot(link.center_of_mass, link.center_of_mass);
  CHECK(about_pivot ==
        doctest::Approx(2e-4 + 0.1 * 0.01 + 0.3 * dot(center, center)).epsilon(1e-12));
}

TEST_CASE("the order of bodies in the file does not matter for the motion") {
  MechanismDescription d;
  d.name = "chain";
  d.bodies = {body("a"), body("b", "a"), body("c", "b")};
  d.bodies[1].position = d.bodies[2].position = {0.2, 0.1};
  const auto forward = assemble(d);
  std::swap(d.bodies[0], d.bodies[2]);
  const auto backward = assemble(d);
  CHECK(forward->coordinates == backward->coordinates);
  Dynamics x(forward), y(backward);
  const std::vector<double> q{0.3, -0.4, 0.8}, v{1.0, 2.0, -3.0};
  x.evaluate({q, v, {}, {}, {}}, {});
  y.evaluate({q, v, {}, {}, {}}, {});
  CHECK((x.acceleration() - y.acceleration()).cwiseAbs().maxCoeff() == 0.0);
}
