/// A contact law as a scalar force between modes.
#pragma once

#include "feltmb/contact/law.hpp"
#include "feltmb/contact/path.hpp"
#include "feltmb/modal/contact_stepper.hpp"

namespace feltmb {

/// Any law of the project, with its memory and its heat, for ModalContactStepper. Copyable: a copy
/// goes on from the last accepted point. The law must outlive it.
class LawForce final : public modal::ScalarForce {
 public:
  explicit LawForce(const ContactLaw& law);

  Value trial(int stage, double elapsed, double compression, double rate) override;
  void accept() override;

  double dissipated() const { return dissipated_; }  ///< heat so far [J], Simpson's rule per step
  double stored() const;                             ///< energy in the felt now [J]

 private:
  struct Point {
    LawPath path;
    double compression = 0.0, rate = 0.0, elapsed = 0.0, heat = 0.0;
  };

  double heat(const Point& p) const;

  const ContactLaw* law_;
  Point now_;
  Point stage_[2];
  double dissipated_ = 0.0;
};

}  // namespace feltmb
