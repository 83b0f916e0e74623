#include <doctest/doctest.h>

#include "feltmb/core/error.hpp"
#include "feltmb/planar/archive.hpp"
#include "feltmb/planar/mechanism.hpp"

namespace {

using namespace feltmb;

/// Of every kind of entry one: bodies, a beam, curves, a table of felt, a formula, a string.
MechanismDescription sample() {
  MechanismDescription d;
  d.name = "a name with spaces and \"quotes\"";
  BodyDescription arm;
  arm.name = "arm";
  arm.coordinate = "arm.angle";
  arm.mass = 0.1;
  arm.inertia = 1.0 / 3.0;
  arm.friction = coulomb(0.2, 0.1, 0.3, 1e-3);
  d.bodies.push_back(arm);
  BodyDescription rod;
  rod.name = "rod";
  rod.parent = "arm";
  rod.joint = JointKind::kWeld;
  rod.beam = BeamDescription{0.1, 0.01, 1e4, 1.0, ShapeSet::kClampedFree, 1, 2, 1e-6, true};
  d.bodies.push_back(rod);
  SurfaceDescription line;
  line.name = "line";
  line.body = "ground";
  line.kind = SurfaceKind::kLine;
  SurfaceDescription round;
  round.name = "round";
  round.body = "arm";
  round.radius = 5e-3;
  d.surfaces = {line, round};
  for (int i = 0; i < 3; ++i) {
    ContactDescription c;
    c.number = i + 1;
    c.surface_a = "line";
    c.surface_b = "round";
    if (i == 0) c.law = ExponentialPair{};
    if (i == 1) {
      FeltMemory felt;
      felt.envelope = Envelope::from_table({0.0, 1e-3, 2e-3}, {0.0, 1.0, 4.0}, {0.0, 0.5, 4.0});
      c.law = felt;
    }
    if (i == 2) c.law = Expression{"k*e^p", {{"k", 1e5}, {"p", 1.5}}, nullptr};
    d.contacts.push_back(c);
  }
  d.springs.push_back({"spring", "arm.angle", 2.0, 0.1, 0.01, 0.0, 0.0});
  StringDescription string;
  string.surface = "line";
  string.parameters.tension = 700.0;
  d.strings.push_back(string);
  d.finger = FingerDescription{"arm", {0.1, 0.0}, {0.0, -1.0}, HuntCrossley{}};
  d.start_pose = {{"arm.angle", 0.1}};
  return d;
}

}  // namespace

TEST_CASE("a description survives its text to the last bit") {
  const MechanismDescription d = sample();
  const std::string text = write_description(d);
  const MechanismDescription read = read_description(text);
  CHECK(write_description(read) == text);
  CHECK(read.name == d.name);
  CHECK(read.bodies[0].inertia == d.bodies[0].inertia);
  REQUIRE(read.bodies[1].beam.has_value());
  CHECK(read.bodies[1].beam->shapes == ShapeSet::kClampedFree);
  const auto& felt = std::get<FeltMemory>(read.contacts[1].law);
  const auto& own = std::get<FeltMemory>(d.contacts[1].law);
  for (const double e : {1e-4, 7e-4, 1.9e-3, 5e-3}) {
    CHECK(felt.envelope->loading(e).force == own.envelope->loading(e).force);
    CHECK(felt.envelope->loading_energy(e) == own.envelope->loading_energy(e));
  }
  CHECK(std::get<Expression>(read.contacts[2].law).parameters.at("p") == 1.5);
}

TEST_CASE("a damaged description is refused with its place") {
  const std::string text = write_description(sample());
  CHECK_THROWS_AS(read_description(""), InvalidParameter);
  CHECK_THROWS_AS(read_description(text.substr(0, text.size() / 2)), InvalidParameter);
  CHECK_THROWS_AS(read_description(text + "x "), InvalidParameter);
  std::string other = text;
  other.replace(other.find("gravity"), 7, "levity_");
  CHECK_THROWS_AS(read_description(other), InvalidParameter);
  // A count of more than there are letters asks for no memory.
  other = text;
  const std::size_t at = other.find("bodies 2 ");
  REQUIRE(at != std::string::npos);
  other.replace(at, 9, "bodies 99999999999 ");
  CHECK_THROWS_AS(read_description(other), InvalidParameter);
}

TEST_CASE("a law by a compiled function cannot be written") {
  MechanismDescription d = sample();
  d.contacts[0].law = Callback{};
  CHECK_THROWS_AS(write_description(d), InvalidParameter);
}

TEST_CASE("numbers have paths, units and places in the description") {
  MechanismDescription d = sample();
  const auto find = [&](const std::string& path) {
    for (const DescriptionNumber& n : numbers_of(d)) {
      if (n.path == path) return n;
    }
    FAIL("no number " << path);
    return DescriptionNumber{};
  };
  CHECK(find("bodies.arm.mass").unit == "kg");
  CHECK(find("bodies.arm.friction.viscous").unit == "N m s/rad");
  CHECK(find("contacts.01.friction.amplitude").unit == "1");
  CHECK(find("contacts.02.memory.kappa").unit == "1");
  CHECK(find("contacts.03.expression.parameters.k").unit.empty());
  CHECK(find("springs.spring.stiffness").unit == "N m/rad");
  CHECK(find("string.tension").unit == "N");
  CHECK(find("surfaces.round.point.x").unit == "m");
  CHECK(find("gravity.y").unit == "m/s^2");
  *find("bodies.arm.mass").value = 0.7;
  CHECK(d.bodies[0].mass == 0.7);
}
