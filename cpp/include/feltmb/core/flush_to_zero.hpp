/// Denormal numbers are treated as zero during the lifetime of an object of this class.
#pragma once

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace feltmb {

/// Decaying modes would become denormal and make every operation a hundred times slower. The
/// destructor restores the setting of the thread.
class FlushToZero {
 public:
#if defined(__SSE2__)
  FlushToZero() : saved_(_mm_getcsr()) { _mm_setcsr(saved_ | 0x8040U); }
  ~FlushToZero() { _mm_setcsr(saved_); }
  FlushToZero(const FlushToZero&) = delete;
  FlushToZero& operator=(const FlushToZero&) = delete;

 private:
  unsigned saved_;
#else
  FlushToZero() {}
  ~FlushToZero() {}
#endif
};

}  // namespace feltmb
