#include "feltmb/contact/laws/formula.hpp"

#include <array>
#include <cmath>
#include <cstdlib>
#include <numbers>
#include <string_view>
#include <utility>

#include "feltmb/core/error.hpp"

namespace feltmb {
namespace {

bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_'; }
bool is_digit(char c) { return c >= '0' && c <= '9'; }

/// Values on the stack of a program: while a level of nesting waits, it holds three at most, one
/// each of a sum, a product and a power or of the first argument.
constexpr std::size_t kStack = 4 * static_cast<std::size_t>(Formula::kDeepest) + 4;

/// Value with the slopes by e and rate.
struct Dual {
  double value, by_e, by_rate;
};

Dual scaled(double value, double slope, const Dual& a) {
  // A slope without end belongs to what moves only.
  const auto chain = [slope](double d) { return d == 0.0 ? 0.0 : slope * d; };
  return {value, chain(a.by_e), chain(a.by_rate)};
}

Dual power(const Dual& a, const Dual& b) {
  const double value = std::pow(a.value, b.value);
  Dual out{value, 0.0, 0.0};
  if (a.by_e != 0.0 || a.by_rate != 0.0) {
    const double slope = b.value == 0.0 ? 0.0 : b.value * std::pow(a.value, b.value - 1.0);
    out.by_e = a.by_e == 0.0 ? 0.0 : slope * a.by_e;
    out.by_rate = a.by_rate == 0.0 ? 0.0 : slope * a.by_rate;
  }
  if (b.by_e != 0.0 || b.by_rate != 0.0) {
    const double slope = value == 0.0 ? 0.0 : value * std::log(a.value);
    out.by_e += b.by_e == 0.0 ? 0.0 : slope * b.by_e;
    out.by_rate += b.by_rate == 0.0 ? 0.0 : slope * b.by_rate;
  }
  return out;
}

}  // namespace

/// Recursive descent; writes the program in the order of evaluation.
class Formula::Parser {
 public:
  Parser(std::string_view text, const std::map<std::string, double>& parameters,
         std::vector<Step>& steps)
      : text_(text), parameters_(parameters), steps_(steps) {}

  void parse() {
    skip();
    if (at_ == text_.size()) fault("is empty");
    sum();
    if (at_ < text_.size()) fault(shown() + ", expected an operator or the end");
  }

  static bool is_function(const std::string& name) { return find(name) != nullptr; }

 private:
  struct Function {
    const char* name;
    int arguments;
    Op op;
  };
  static constexpr std::array<Function, 9> kFunctions{{{"exp", 1, Op::kExp},
                                                       {"log", 1, Op::kLog},
                                                       {"sqrt", 1, Op::kSqrt},
                                                       {"tanh", 1, Op::kTanh},
                                                       {"abs", 1, Op::kAbs},
                                                       {"sign", 1, Op::kSign},
                                                       {"min", 2, Op::kMin},
                                                       {"max", 2, Op::kMax},
                                                       {"pow", 2, Op::kPower}}};
  static const Function* find(const std::string& name) {
    for (const Function& f : kFunctions) {
      if (name == f.name) return &f;
    }
    return nullptr;
  }

  [[noreturn]] void fault(const std::string& what) const { fault(what, at_); }
  [[noreturn]] void fault(const std::string& what, std::size_t place) const {
    // Letters of UTF-8 may take several bytes, which begin with the bits 10 but for the first.
    std::size_t column = 1;
    for (const char c : text_.substr(0, place)) column += is_later_byte(c) ? 0 : 1;
    throw InvalidParameter(format("column %zu: ", column) + what);
  }
  static bool is_later_byte(char c) { return (static_cast<unsigned char>(c) & 0xC0U) == 0x80U; }
  std::string shown() const {
    if (at_ == text_.size()) return "got the end";
    if (static_cast<unsigned char>(text_[at_]) < 0x20U) return "got a control character";
    std::size_t end = at_ + 1;
    while (end < text_.size() && is_later_byte(text_[end])) ++end;
    return "got '" + std::string(text_.substr(at_, end - at_)) + "'";
  }
  void skip() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\t' || text_[at_] == '\n')) {
      ++at_;
    }
  }
  bool take(char c) {
    if (at_ == text_.size() || text_[at_] != c) return false;
    ++at_;
    skip();
    return true;
  }
  void write(Op op, double number = 0.0) { steps_.push_back({op, number}); }

  struct Level {
    explicit Level(Parser& parser) : of(parser) {
      if (++of.depth_ > kDeepest) of.fault(format("is nested more than %d deep", kDeepest));
    }
    ~Level() { --of.depth_; }
    Parser& of;
  };

  void sum() {
    const Level level(*this);
    product();
    for (;;) {
      if (take('+')) {
        product();
        write(Op::kAdd);
      } else if (take('-')) {
        product();
        write(Op::kSubtract);
      } else {
        return;
      }
    }
  }
  void product() {
    signed_power();
    for (;;) {
      if (take('*')) {
        signed_power();
        write(Op::kMultiply);
      } else if (take('/')) {
        signed_power();
        write(Op::kDivide);
      } else {
        return;
      }
    }
  }
  void signed_power() {
    const Level level(*this);
    if (take('-')) {
      signed_power();
      write(Op::kNegate);
    } else if (take('+')) {
      signed_power();
    } else {
      atom();
      if (!take('^')) return;
      signed_power();
      write(Op::kPower);
    }
  }
  void atom() {
    if (take('(')) {
      sum();
      close("')'");
    } else if (at_ < text_.size() && (is_digit(text_[at_]) || text_[at_] == '.')) {
      number();
    } else if (at_ < text_.size() && is_letter(text_[at_])) {
      name();
    } else {
      fault(shown() + ", expected a number, a name or '('");
    }
  }
  void close(const char* expected) {
    if (!take(')')) fault(shown() + ", expected " + expected);
  }
  void number() {
    const std::size_t start = at_;
    while (at_ < text_.size() && (is_digit(text_[at_]) || text_[at_] == '.')) ++at_;
    if (at_ < text_.size() && (text_[at_] == 'e' || text_[at_] == 'E')) {
      // An exponent, or the compression right behind a number: that is a fault in any case.
      std::size_t next = at_ + 1;
      if (next < text_.size() && (text_[next] == '+' || text_[next] == '-')) ++next;
      if (next < text_.size() && is_digit(text_[next])) {
        while (next < text_.size() && is_digit(text_[next])) ++next;
        at_ = next;
      }
    }
    const std::string word(text_.substr(start, at_ - start));
    char* end = nullptr;
    const double value = std::strtod(word.c_str(), &end);
    if (*end != '\0' || !std::isfinite(value)) {
      fault("got " + word + ", expected a finite number", start);
    }
    skip();
    write(Op::kNumber, value);
  }
  void name() {
    const std::size_t start = at_;
    while (at_ < text_.size() && (is_letter(text_[at_]) || is_digit(text_[at_]))) ++at_;
    const std::string word(text_.substr(start, at_ - start));
    skip();
    if (const Function* function = find(word)) {
      if (!take('(')) fault(shown() + ", expected '(' after " + word);
      for (int i = 0; i < function->arguments; ++i) {
        if (i > 0 && !take(',')) fault(shown() + ", expected ',': " + word + " takes 2 arguments");
        sum();
      }
      close(function->arguments == 1 ? "')'" : "')' after 2 arguments");
      write(function->op);
    } else if (word == "e") {
      write(Op::kCompression);
    } else if (word == "rate") {
      write(Op::kRate);
    } else if (const auto own = parameters_.find(word); own != parameters_.end()) {
      write(Op::kNumber, own->second);
    } else if (word == "pi") {
      write(Op::kNumber, std::numbers::pi);
    } else {
      std::string known = "e, rate, pi";
      for (const auto& [key, value] : parameters_) known += ", " + key;
      for (const Function& f : kFunctions) known += std::string(", ") + f.name;
      fault("unknown name '" + word + "'; known are " + known, start);
    }
  }

  std::string_view text_;
  const std::map<std::string, double>& parameters_;
  std::vector<Step>& steps_;
  std::size_t at_ = 0;
  int depth_ = 0;
};

Formula::Formula(const std::string& text, const std::map<std::string, double>& parameters) {
  if (text.size() > kMostLetters) {
    throw InvalidParameter(
        format("has %zu letters, at most %zu are accepted", text.size(), kMostLetters));
  }
  if (parameters.size() > kMostParameters) {
    throw InvalidParameter(
        format("has %zu parameters, at most %zu are accepted", parameters.size(), kMostParameters));
  }
  for (const auto& [name, value] : parameters) {
    bool good = !name.empty() && is_letter(name[0]);
    for (const char c : name) good = good && (is_letter(c) || is_digit(c));
    if (!good) {
      throw InvalidParameter("parameter '" + name +
                             "': expected a name of letters, digits and _, a letter first");
    }
    if (name == "e" || name == "rate" || Parser::is_function(name)) {
      throw InvalidParameter("parameter '" + name + "': the name has a meaning already");
    }
    if (!std::isfinite(value)) {
      throw InvalidParameter(format("parameter '%s' = %.6g, must be finite", name.c_str(), value));
    }
  }
  Parser(text, parameters, steps_).parse();
}

template <class Choose>
LawValue Formula::run(double e, double rate, Choose&& choose) const {
  std::array<Dual, kStack> stack;
  Dual* top = stack.data();  // the first is below all
  for (const Step& step : steps_) {
    switch (step.op) {
      case Op::kNumber:
        *++top = {step.number, 0.0, 0.0};
        continue;
      case Op::kCompression:
        *++top = {e, 1.0, 0.0};
        continue;
      case Op::kRate:
        *++top = {rate, 0.0, 1.0};
        continue;
      default:
        break;
    }
    if (step.op <= Op::kMax) {
      const Dual b = *top--;
      Dual& a = *top;
      switch (step.op) {
        case Op::kAdd:
          a = {a.value + b.value, a.by_e + b.by_e, a.by_rate + b.by_rate};
          break;
        case Op::kSubtract:
          a = {a.value - b.value, a.by_e - b.by_e, a.by_rate - b.by_rate};
          break;
        case Op::kMultiply:
          a = {a.value * b.value, a.by_e * b.value + a.value * b.by_e,
               a.by_rate * b.value + a.value * b.by_rate};
          break;
        case Op::kDivide: {
          const double q = a.value / b.value;
          a = {q, (a.by_e - q * b.by_e) / b.value, (a.by_rate - q * b.by_rate) / b.value};
          break;
        }
        case Op::kPower:
          a = power(a, b);
          break;
        default: {  // kMin, kMax
          const bool first = step.op == Op::kMin ? a.value <= b.value : a.value >= b.value;
          choose(first ? 0 : 1);
          // What is no number is not passed over.
          if (!first && !std::isnan(a.value)) a = b;
        }
      }
      continue;
    }
    Dual& a = *top;
    switch (step.op) {
      case Op::kNegate:
        a = {-a.value, -a.by_e, -a.by_rate};
        break;
      case Op::kExp: {
        const double v = std::exp(a.value);
        a = scaled(v, v, a);
        break;
      }
      case Op::kLog:
        a = scaled(std::log(a.value), 1.0 / a.value, a);
        break;
      case Op::kSqrt: {
        const double v = std::sqrt(a.value);
        a = scaled(v, 0.5 / v, a);
        break;
      }
      case Op::kTanh: {
        const double v = std::tanh(a.value);
        a = scaled(v, 1.0 - v * v, a);
        break;
      }
      case Op::kAbs:
        choose(a.value < 0.0 ? 1 : 0);
        if (a.value < 0.0) a = {-a.value, -a.by_e, -a.by_rate};
        break;
      default:  // kSign
        choose(a.value < 0.0 ? 1 : (a.value > 0.0 ? 2 : 0));
        if (!std::isnan(a.value)) {
          a = {a.value > 0.0 ? 1.0 : (a.value < 0.0 ? -1.0 : 0.0), 0.0, 0.0};
        }
    }
  }
  return {top->value, top->by_e, top->by_rate};
}

LawValue Formula::evaluate(double e, double rate) const {
  return run(e, rate, [](int) {});
}

int Formula::choices(double e, double rate) const {
  unsigned number = 0;
  run(e, rate, [&](int way) { number = (3 * number + static_cast<unsigned>(way)) % 1000000007U; });
  return static_cast<int>(number);
}

}  // namespace feltmb
