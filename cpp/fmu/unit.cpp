#include "unit.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <sstream>
#include <utility>

#include "feltmb/core/error.hpp"

namespace feltmb::fmu {
namespace {

/// Peak before the first step.
constexpr double kNoStep = std::numeric_limits<double>::quiet_NaN();

}  // namespace

std::string read_resource(const std::string& path, const std::string& head,
                          const std::string& token) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw Error("cannot read " + path);
  std::string word, own;
  file >> word >> own;
  if (!file || word != head) throw Error(path + " is none of feltmb");
  if (own != token) throw Error(path + " belongs to another model description");
  file.get();
  std::ostringstream rest;
  rest << file.rdbuf();
  return std::move(rest).str();
}

std::unique_ptr<Unit> open_unit(const std::string& resources, const std::string& token) {
  const std::string felt = resources + "/felt.txt";
  if (std::ifstream(felt)) return open_felt(felt, token);
  return std::make_unique<Machine>(resources + "/machine.txt", token);
}

void Unit::step(double at, double duration) {
  if (std::fabs(at - time()) > 1e-9 * std::fmax(1.0, std::fabs(at))) {
    throw InvalidParameter(format("step from %.9g s, but the unit is at %.9g s", at, time()));
  }
  advance(duration);
}

Machine::Machine(const std::string& path, const std::string& token) {
  // KIND HOLD METHOD ORDER RTOL, then the description
  std::istringstream file(read_resource(path, "feltmb-unit", token));
  std::string kind, hold, method, rtol;
  file >> kind >> hold >> method >> options_.max_order >> rtol;
  kind_ = input_kind(kind);
  hold_ = hold == "linear" ? Hold::kLinear : Hold::kZero;
  options_.method = method_from_name(method);
  options_.rtol = std::strtod(rtol.c_str(), nullptr);
  options_.events = false;
  file.get();
  std::ostringstream rest;
  rest << file.rdbuf();
  original_ = read_description(rest.str());
  description_ = original_;
  numbers_ = numbers_of(description_);
  const auto mechanism = assemble(description_);
  starts_.assign(2 * static_cast<std::size_t>(mechanism->size()), 0.0);
  peaks_.assign(mechanism->contacts.size(), kNoStep);
}

Stepper& Machine::stepper() {
  if (!stepper_) {
    for (const DescriptionNumber& number : numbers_) {
      if (number.range.holds(*number.value)) continue;
      throw InvalidParameter(
          number_fault(number.path.c_str(), *number.value, number.unit.c_str(), number.range));
    }
    auto made = std::make_unique<Stepper>(assemble(description_), kind_, options_);
    StepState start = made->rest();
    for (std::size_t i = 0; i < starts_.size(); ++i) start.machine.y[i] += starts_[i];
    made->set_state(start);
    if (watched_) made->watch_peaks();
    stepper_ = std::move(made);
  }
  return *stepper_;
}

Stepper& Machine::with_input() {
  Stepper& own = stepper();
  // A held force or torque acts at once. Others start at their last value.
  if (hold_ == Hold::kZero && !is_prescribed(kind_) && own.state().drive.value != input_) {
    StepState now = own.state();
    now.drive.value = input_;
    own.set_state(now);
  }
  return own;
}

const std::vector<double>& Machine::peaks() {
  if (watched_) return peaks_;
  watched_ = true;
  Stepper& own = stepper();
  own.watch_peaks();
  if (last_duration_ > 0.0) {
    const StepState now = own.state();
    own.set_state(before_);
    peaks_ = own.advance(last_duration_, {last_input_}, hold_).peaks;
    own.set_state(now);
  }
  return peaks_;
}

double Machine::get(std::uint32_t reference) {
  if (reference == kTime) return time();
  if (reference == kInput) return input_;
  if (reference == kTolerance) return options_.rtol;
  if (reference >= kStarts && reference - kStarts < starts_.size()) {
    return starts_[reference - kStarts];
  }
  if (reference >= kParameters && reference - kParameters < numbers_.size()) {
    return *numbers_[reference - kParameters].value;
  }
  if (reference >= kPeaks && reference - kPeaks < peaks_.size()) {
    const double peak = peaks()[reference - kPeaks];
    return std::isnan(peak) ? with_input().forces()[reference - kPeaks] : peak;
  }
  if (reference >= kOutputs && reference - kOutputs < stepper().channels().size()) {
    return with_input().outputs()[reference - kOutputs];
  }
  throw InvalidParameter(format("there is no variable with reference %u", reference));
}

void Machine::set(std::uint32_t reference, double value) {
  const auto change = [this, value](double& fixed, const std::string& name) {
    if (stepper_ && stepper_->state().machine.time > 0.0) {
      throw InvalidParameter(name + " is fixed: it can be set before the first step only");
    }
    fixed = value;
    stepper_.reset();
  };
  if (reference == kInput) {
    input_ = value;
  } else if (reference == kTolerance) {
    change(options_.rtol, "rtol");
  } else if (reference >= kStarts && reference - kStarts < starts_.size()) {
    if (!std::isfinite(value)) throw InvalidParameter("an initial value is not a finite number");
    change(starts_[reference - kStarts], "an initial value");
  } else if (reference >= kParameters && reference - kParameters < numbers_.size()) {
    const DescriptionNumber& number = numbers_[reference - kParameters];
    change(*number.value, number.path);
  } else {
    throw InvalidParameter(format("there is no variable to set with reference %u", reference));
  }
}

void Machine::reset() {
  stepper_.reset();
  // In place: the numbers point into it.
  std::vector<DescriptionNumber> first = numbers_of(original_);
  for (std::size_t i = 0; i < first.size(); ++i) *numbers_[i].value = *first[i].value;
  std::fill(starts_.begin(), starts_.end(), 0.0);
  std::fill(peaks_.begin(), peaks_.end(), kNoStep);
  start_ = input_ = last_duration_ = 0.0;
}

void Machine::advance(double duration) {
  Stepper& own = stepper();
  StepState before;
  if (!watched_) before = own.state();
  const StepResult done = own.advance(duration, {input_}, hold_);
  if (done.status != RunStatus::kDone) throw Error(done.message, done.code);
  if (watched_) {
    peaks_ = done.peaks;
  } else {
    before_ = std::move(before);
    last_duration_ = duration;
    last_input_ = input_;
  }
}

std::vector<double> Machine::save() {
  const std::vector<double>& largest = peaks();
  const StepState& s = stepper().state();
  std::vector<double> out{start_,        input_,       options_.rtol,        s.machine.time,
                          s.drive.value, s.drive.rate, s.drive.acceleration, s.drive.mean};
  for (const DescriptionNumber& number : numbers_) out.push_back(*number.value);
  out.insert(out.end(), starts_.begin(), starts_.end());
  out.insert(out.end(), largest.begin(), largest.end());
  out.insert(out.end(), s.machine.y.begin(), s.machine.y.end());
  out.insert(out.end(), s.machine.largest_compression.begin(), s.machine.largest_compression.end());
  return out;
}

void Machine::restore(const std::vector<double>& saved) {
  // Turning points are as many as there are.
  const std::size_t now = save().size() - stepper().state().machine.largest_compression.size() +
                          stepper().rest().machine.largest_compression.size();
  if (saved.size() < now) throw InvalidParameter("the state is of another unit");
  std::size_t i = 0;
  const auto next = [&] { return saved[i++]; };
  start_ = next();
  input_ = next();
  bool other = options_.rtol != saved[i];
  options_.rtol = next();
  StepState s;
  s.machine.time = next();
  s.drive = {kind_, 0.0, 0.0, 0.0, 0.0};
  s.drive.value = next();
  s.drive.rate = next();
  s.drive.acceleration = next();
  s.drive.mean = next();
  for (const DescriptionNumber& number : numbers_) {
    other = other || *number.value != saved[i];
    *number.value = next();
  }
  for (double& start : starts_) start = next();
  for (double& peak : peaks_) peak = next();
  if (other) stepper_.reset();
  for (std::size_t n = stepper().rest().machine.y.size(); n > 0; --n) s.machine.y.push_back(next());
  while (i < saved.size()) s.machine.largest_compression.push_back(next());
  stepper().set_state(s);
}

}  // namespace feltmb::fmu
