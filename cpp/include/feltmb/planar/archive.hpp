/// Descriptions of mechanisms as text, to the last bit, and their numbers by path. What is written
/// follows from the tables of fields.
#pragma once

#include <string>
#include <vector>

#include "feltmb/planar/description.hpp"

namespace feltmb {

/// Text for `read_description` of the same version. Throws InvalidParameter for a law by a compiled
/// function, which is an address in this process.
std::string write_description(const MechanismDescription& description);

/// Throws InvalidParameter naming the first fault.
MechanismDescription read_description(const std::string& text);

/// A real number of a description.
struct DescriptionNumber {
  std::string path;  ///< as of a mechanism file where that has the number: "bodies.key.mass"
  std::string unit;  ///< SI
  std::string meaning;
  Range range;
  double* value;  ///< in the description
};

/// All real numbers, in the order of the description.
std::vector<DescriptionNumber> numbers_of(MechanismDescription& description);

/// The same for a contact law alone; its numbers have the names of its fields ("kappa").
std::string write_law(const LawParameters& law);
LawParameters read_law(const std::string& text);
std::vector<DescriptionNumber> numbers_of(LawParameters& law);

}  // namespace feltmb
