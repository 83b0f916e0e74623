// Uses the installed headers and library; prints the version that it was built against.
#include <cstdio>

#include "feltmb/core/error.hpp"

int main() {
  try {
    throw feltmb::InvalidParameter(feltmb::format("stiffness = %.6g N/m", -4e8));
  } catch (const feltmb::Error& error) {
    std::printf("%s\n%s\n", FELTMB_VERSION, error.what());
  }
}
