/// Denormal numbers taken as zero while an object of this class lives.
#pragma once

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace feltmb {

/// Decaying modes would turn denormal and slow every operation down a hundredfold. The setting of
/// the thread comes back on leaving.
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
