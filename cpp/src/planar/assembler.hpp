/// Makes a mechanism from its description; collects all faults. Private to the folder.
#pragma once

#include <cmath>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "feltmb/core/index.hpp"
#include "feltmb/planar/mechanism.hpp"

namespace feltmb {

class Assembler {
 public:
  explicit Assembler(const MechanismDescription& description) : d_(description) {}

  std::shared_ptr<const Mechanism> run();

 private:
  void fault(const std::string& text) { faults_.push_back(text); }

  bool finite(Vec2 v) const { return std::isfinite(v.x) && std::isfinite(v.y); }

  const Placement* find_body(const std::string& body, const std::string& where);

  /// A point of a body as a point of a link; on a flexible beam, of the station at its x.
  LinkPoint place(const Placement& p, Vec2 local, const std::string& where);

  /// Frame at a point of a body, for a joint there.
  Placement frame(const Placement& p, Vec2 local, const std::string& where);

  /// Link of the cross section of a beam at x; made when first asked for.
  int station(int beam, double x, const std::string& where);
  int add_station(int index, double x, bool lump);

  void add_bodies();
  void place_body(const BodyDescription& b, const Placement& parent_body);
  int add_coordinate(const std::string& name, bool angle, const std::string& where, int parent_link,
                     const Friction& friction);
  void add_beam(const BodyDescription& b, const Placement& base);
  static void integrate_mass(FlexibleBeam& beam, const BeamDescription& d);
  static void integrate_stiffness(FlexibleBeam& beam, const BeamDescription& d);
  static void merge(Link& link, double mass, Vec2 center, double inertia);
  /// Faults of the numbers that are out of their range.
  template <class S>
  void check(const S& numbers, const std::string& where, Site site = Site::kAny) {
    check_numbers(numbers, [&](const std::string& text) { fault(where + text); }, site);
  }
  Site site_of(int coordinate) const {
    return coordinate < 0 || m_->coordinate_is_angle[static_cast<std::size_t>(coordinate)]
               ? Site::kRevolute
               : Site::kPrismatic;
  }
  void add_surfaces();
  static const char* kind_name(SurfaceKind kind);
  const SurfaceDescription* find_surface(const std::string& name, const std::string& where);
  const SurfaceDescription* string_line(const std::string& name, const std::string& where);
  void check_along_string(const StringDescription& s, const SurfaceDescription& first,
                          const SurfaceDescription& line, const std::string& where);
  void add_string_contacts(std::vector<StringContact>& touching, const StringDescription& s,
                           const SurfaceDescription& first, const std::string& name,
                           const std::string& where);
  void add_contacts();
  void set_geometry(Contact& contact, const SurfaceDescription& sa, const SurfaceDescription& sb,
                    const std::string& where);
  void set_coordinates(std::vector<int>& out, int link_a, int link_b) const;
  void add_finger();
  void add_motor();
  void add_strings();
  int find_coordinate(const std::string& name, const std::string& where);
  void add_springs();
  void add_dashpots();
  void add_straps();
  void add_points();
  void add_start_pose();
  void check_inertia();
  void set_scales();

  const MechanismDescription& d_;
  std::shared_ptr<Mechanism> m_;
  std::map<std::string, Placement> placement_;
  std::set<std::string> unplaced_;
  std::map<std::string, const SurfaceDescription*> surfaces_;
  std::vector<std::string> faults_;
};

}  // namespace feltmb
