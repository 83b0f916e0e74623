#include "feltmb/planar/archive.hpp"

#include <charconv>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>

#include "feltmb/contact/laws/catalog.hpp"
#include "feltmb/core/error.hpp"

namespace feltmb {

/// The tables of an envelope.
struct EnvelopeTables {
  template <class Self, class Use>
  static void each(Self& e, Use&& use) {
    use(e.exponential_);
    use(e.curve_.a);
    use(e.curve_.b);
    use(e.curve_.c);
    use(e.first_positive_);
    use(e.energy_offset_);
    use(e.closing_);
    use(e.reach_);
    use(e.area_reach_);
    use(e.repair_.force);
    use(e.repair_.low);
    use(e.repair_.high);
    use(e.rows_);
    for (auto* table : {&e.rho_, &e.rho_slope_, &e.load_, &e.load_slope_, &e.load_energy_, &e.area_,
                        &e.area_slope_, &e.share_, &e.share_slope_}) {
      use(*table);
    }
    use(e.rho_pieces_);
    use(e.load_pieces_);
  }
  static Envelope empty() { return {}; }
};

namespace {

template <class T>
concept Fielded = requires { T::fields(); };

// ---------------------------------------------------------------- writing

class Writer {
 public:
  void word(const std::string& text) {
    out_ += text;
    out_ += ' ';
  }
  void put(double v) { word(format("%a", v)); }
  void put(bool v) { word(v ? "1" : "0"); }
  void put(const std::string& v) {
    word(std::to_string(v.size()));
    out_ += v;
    out_ += ' ';
  }
  void put(const Vec2& v) {
    put(v.x);
    put(v.y);
  }
  void put(const ExponentialCurve& v) {
    for (const double each : {v.a, v.b, v.c}) put(each);
  }
  void put(const CubicPiece& v) {
    for (const double each : {v.value, v.slope, v.second, v.third}) put(each);
  }
  template <class T>
    requires std::is_integral_v<T>
  void put(T v) {
    word(std::to_string(v));
  }
  template <class T>
    requires std::is_enum_v<T>
  void put(T v) {
    word(std::to_string(static_cast<int>(v)));
  }
  template <class T, std::size_t N>
  void put(const std::array<T, N>& v) {
    for (const T& each : v) put(each);
  }
  template <class T>
  void put(const std::vector<T>& v) {
    put(v.size());
    for (const T& each : v) put(each);
  }
  template <class A, class B>
  void put(const std::pair<A, B>& v) {
    put(v.first);
    put(v.second);
  }
  void put(const std::map<std::string, double>& v) {
    put(v.size());
    for (const auto& each : v) put(each);
  }
  template <class T>
  void put(const std::optional<T>& v) {
    put(v.has_value());
    if (v) put(*v);
  }
  void put(const std::shared_ptr<const Envelope>& v) {
    put(v != nullptr);
    if (v) EnvelopeTables::each(*v, [&](const auto& part) { put(part); });
  }
  void put(const LawFunction&) {
    throw InvalidParameter(
        "a law by a compiled function of the caller cannot be written; it is an address in this "
        "process");
  }
  void put(const LawParameters& v) {
    word(chosen_name(v).name);
    std::visit([&](const auto& law) { put(law); }, v);
  }
  template <Fielded S>
  void put(const S& object) {
    each_field(object, [&](const auto& field, const auto& value) {
      word(field.name);
      put(value);
    });
  }

  std::string text() && { return std::move(out_); }

 private:
  std::string out_;
};

// ---------------------------------------------------------------- reading

class Reader {
 public:
  Reader(const std::string& text, const char* what) : text_(text), what_(what) {}

  std::string word() {
    const std::size_t end = text_.find(' ', at_);
    if (end == std::string::npos) fault("it ends early");
    std::string out = text_.substr(at_, end - at_);
    at_ = end + 1;
    return out;
  }
  void expect(const std::string& wanted) {
    const std::string got = word();
    if (got != wanted) fault("got \"" + got + "\", expected \"" + wanted + "\"");
  }
  void end() const {
    if (at_ != text_.size()) fault("something follows its end");
  }

  void get(double& v) {
    const std::string own = word();
    char* stop = nullptr;
    v = std::strtod(own.c_str(), &stop);
    if (own.empty() || *stop != '\0') fault("got \"" + own + "\", expected a number");
  }
  void get(bool& v) { v = integer<int>(0, 1) == 1; }
  void get(std::string& v) {
    const std::size_t count = size();
    v = text_.substr(at_, count);
    at_ += count;
    if (at_ >= text_.size() || text_[at_] != ' ') fault("a text does not end");
    ++at_;
  }
  void get(Vec2& v) {
    get(v.x);
    get(v.y);
  }
  void get(ExponentialCurve& v) {
    for (double* each : {&v.a, &v.b, &v.c}) get(*each);
  }
  void get(CubicPiece& v) {
    for (double* each : {&v.value, &v.slope, &v.second, &v.third}) get(*each);
  }
  template <class T>
    requires std::is_integral_v<T>
  void get(T& v) {
    v = integer<T>(std::numeric_limits<T>::min(), std::numeric_limits<T>::max());
  }
  template <class T>
    requires std::is_enum_v<T>
  void get(T& v) {
    constexpr int most = 15;  // of no enum are there more
    v = static_cast<T>(integer<int>(0, most));
  }
  template <class T, std::size_t N>
  void get(std::array<T, N>& v) {
    for (T& each : v) get(each);
  }
  template <class T>
  void get(std::vector<T>& v) {
    v.resize(size());
    for (T& each : v) get(each);
  }
  template <class A, class B>
  void get(std::pair<A, B>& v) {
    get(v.first);
    get(v.second);
  }
  void get(std::map<std::string, double>& v) {
    for (std::size_t i = size(); i > 0; --i) {
      std::pair<std::string, double> each;
      get(each);
      v.insert(each);
    }
  }
  template <class T>
  void get(std::optional<T>& v) {
    bool there = false;
    get(there);
    v.reset();
    if (there) get(v.emplace());
  }
  void get(std::shared_ptr<const Envelope>& v) {
    bool there = false;
    get(there);
    if (!there) return;
    auto made = std::make_shared<Envelope>(EnvelopeTables::empty());
    EnvelopeTables::each(*made, [&](auto& part) { get(part); });
    v = made;
  }
  void get(LawFunction&) { fault("a law by a compiled function cannot be read"); }
  void get(LawParameters& v) {
    const std::string name = word();
    v = make_contact_law(name, {});
    std::visit([&](auto& law) { get(law); }, v);
  }
  template <Fielded S>
  void get(S& object) {
    each_field(object, [&](const auto& field, auto& value) {
      expect(field.name);
      get(value);
    });
  }

 private:
  template <class T>
  T integer(T low, T high) {
    const std::string own = word();
    T v{};
    const auto [stop, error] = std::from_chars(own.data(), own.data() + own.size(), v);
    if (error != std::errc{} || stop != own.data() + own.size() || v < low || v > high) {
      fault("got \"" + own + "\", expected a whole number");
    }
    return v;
  }
  /// A count of things that take a letter each at least.
  std::size_t size() { return integer<std::size_t>(0, text_.size() - at_); }

  [[noreturn]] void fault(const std::string& what) const {
    throw InvalidParameter(format("%s, letter %zu: %s", what_, at_, what.c_str()));
  }

  const std::string& text_;
  const char* what_;
  std::size_t at_ = 0;
};

constexpr const char* kHead = "feltmb-description";
constexpr const char* kLaw = "feltmb-law";

template <class T>
std::string written(const char* head, const T& value) {
  Writer out;
  out.word(head);
  out.word(FELTMB_VERSION);
  out.put(value);
  return std::move(out).text();
}

template <class T>
T read(const char* head, const std::string& text, const char* what) {
  Reader in(text, what);
  in.expect(head);
  in.expect(FELTMB_VERSION);
  T out;
  in.get(out);
  in.end();
  return out;
}

// ---------------------------------------------------------------- numbers

Site site_of(JointKind joint) {
  return joint == JointKind::kPrismatic ? Site::kPrismatic : Site::kRevolute;
}

class Numbers {
 public:
  std::vector<DescriptionNumber> of(MechanismDescription& description) {
    bodies_ = description.bodies;
    number("gravity.x", description.gravity.x, "m/s^2");
    number("gravity.y", description.gravity.y, "m/s^2");
    each_field(description, [&](const auto& field, auto& value) {
      if constexpr (requires { add(field.name, value); }) add(field.name, value);
    });
    return std::move(out_);
  }

  /// Those of a law alone, with the names of its fields.
  std::vector<DescriptionNumber> of(LawParameters& law) {
    site_ = Site::kContact;
    std::visit(
        [&](auto& own) {
          each_field(own, [&](const auto& field, auto& value) { add_field("", field, value); });
        },
        law);
    return std::move(out_);
  }

 private:
  /// What a row of a table is called.
  template <class T>
  static std::string name_of(const T& row) {
    if constexpr (requires { row.number; }) {
      return format("%02d", row.number);
    } else {
      return row.name;
    }
  }

  /// What a meaning such as "center [m]" says of the unit.
  static std::string unit_in(const std::string& meaning) {
    const std::size_t open = meaning.find('[');
    const std::size_t close = meaning.find(']', open);
    if (open == meaning.npos || close == meaning.npos) return "1";
    return meaning.substr(open + 1, close - open - 1);
  }

  Site site_at(const std::string& coordinate) const {
    for (const BodyDescription& body : bodies_) {
      if (body.coordinate == coordinate) return site_of(body.joint);
    }
    return Site::kRevolute;
  }

  void number(const std::string& path, double& value, const char* unit = "",
              const char* meaning = "", const Range& range = {}) {
    out_.push_back({path, unit_at(unit, site_), meaning, range, &value});
  }

  void add(const std::string& path, ExponentialCurve& v) {
    number(path + ".a", v.a, "N/m");
    number(path + ".b", v.b, "1/m");
    number(path + ".c", v.c, "N/m");
  }
  void add(const std::string& path, std::vector<std::pair<std::string, double>>& v) {
    for (auto& [name, value] : v) number(path + "." + name, value);
  }
  void add(const std::string& path, std::map<std::string, double>& v) {
    for (auto& [name, value] : v) number(path + "." + name, value);
  }
  template <Fielded T>
  void add(const std::string& path, std::vector<T>& rows) {
    if constexpr (std::is_same_v<T, StringDescription>) {
      if (rows.size() == 1) return add("string", rows[0]);
    }
    for (T& row : rows) {
      if constexpr (requires { row.joint; }) site_ = site_of(row.joint);
      if constexpr (requires { row.coordinate; }) site_ = site_at(row.coordinate);
      if constexpr (requires { row.law; }) site_ = Site::kContact;
      add(path + "." + name_of(row), row);
      site_ = Site::kAny;
    }
  }
  template <class T>
  void add(const std::string& path, std::optional<T>& v) {
    if (v) add(path, *v);
  }
  void add(const std::string& path, LawParameters& v) {
    // A file has what laws share in the contact itself, the rest in a table of the law.
    const std::string contact = path.substr(0, path.rfind(".law"));
    std::visit(
        [&](auto& law) {
          using L = std::remove_cvref_t<decltype(law)>;
          std::string table = L::kNames[0].name;
          if constexpr (requires { L::kTable; }) table = L::kTable;
          each_field(law, [&](const auto& field, auto& value) {
            const bool own = field.place == Place::kTable;
            add_field(contact + (own ? "." + table : std::string()), field, value);
          });
        },
        v);
  }
  template <Fielded S>
  void add(const std::string& path, S& object) {
    each_field(object, [&](const auto& field, auto& value) {
      if (acts(object, field.name)) add_field(path, field, value);
    });
  }

  /// Whether an entry of a row does anything, by what the row is: one that does not is no number of
  /// this mechanism.
  template <class T>
  static bool acts(const T&, std::string_view) {
    return true;
  }
  static bool acts(const SurfaceDescription& surface, std::string_view entry) {
    using K = SurfaceKind;
    if (entry == "normal") return surface.kind == K::kLine;
    if (entry == "radius") return surface.kind != K::kLine;
    if (entry == "arc") return surface.kind == K::kHybrid || surface.kind == K::kConcaveArc;
    if (entry == "end") return surface.kind == K::kSegment;
    return true;
  }
  static bool acts(const BodyDescription& body, std::string_view entry) {
    if (entry == "axis") return body.joint == JointKind::kPrismatic;
    if (entry == "friction") return body.joint != JointKind::kWeld;
    // A beam has its mass from its density.
    if (entry == "mass" || entry == "center_of_mass" || entry == "inertia") return !body.beam;
    return true;
  }
  static bool acts(const ContactDescription& contact, std::string_view) { return contact.enabled; }

  template <class F, class T>
  void add_field(const std::string& path, const F& field, T& value) {
    const std::string own = (path.empty() ? "" : path + ".") + field.name;
    if constexpr (std::is_same_v<T, double>) {
      number(own, value, field.unit, field.meaning, field.range);
    } else if constexpr (std::is_same_v<T, StringParameters>) {
      add(path, value);  // a file has them in the table of the string
    } else if constexpr (std::is_same_v<T, Vec2>) {
      const std::string unit = unit_in(field.meaning);
      number(own + ".x", value.x, unit.c_str(), field.meaning);
      number(own + ".y", value.y, unit.c_str(), field.meaning);
    } else if constexpr (requires { value.fill(0.0); }) {
      for (std::size_t i = 0; i < value.size(); ++i) {
        number(own + "." + std::to_string(i), value[i], "", field.meaning);
      }
    } else if constexpr (requires { add(own, value); }) {
      add(own, value);
    }
  }
  /// Names, choices, counts and tables of felt are no numbers.
  template <class T>
    requires(std::is_arithmetic_v<T> || std::is_enum_v<T> || std::is_same_v<T, std::string> ||
             std::is_pointer_v<T>)
  void add(const std::string&, T&) {}
  void add(const std::string&, std::vector<std::string>&) {}
  void add(const std::string&, std::vector<double>&) {}
  void add(const std::string&, std::shared_ptr<const Envelope>&) {}

  std::span<const BodyDescription> bodies_;  ///< which have the coordinates
  std::vector<DescriptionNumber> out_;
  Site site_ = Site::kAny;
};

}  // namespace

std::string write_description(const MechanismDescription& description) {
  return written(kHead, description);
}

MechanismDescription read_description(const std::string& text) {
  return read<MechanismDescription>(kHead, text, "description of a mechanism");
}

std::vector<DescriptionNumber> numbers_of(MechanismDescription& description) {
  return Numbers().of(description);
}

std::string write_law(const LawParameters& law) { return written(kLaw, law); }

LawParameters read_law(const std::string& text) {
  return read<LawParameters>(kLaw, text, "text of a contact law");
}

std::vector<DescriptionNumber> numbers_of(LawParameters& law) { return Numbers().of(law); }

}  // namespace feltmb
