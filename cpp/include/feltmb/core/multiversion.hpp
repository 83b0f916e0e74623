/// Function multiversioning: one binary runs on all processors, and the loader selects the clone
/// with the widest vectors.
///
/// It is used for the two kernels that benefit, the LU of Newton's matrix and the vectors of the
/// integrator (bench/results/kernels.md). Kernels marked so must not depend on the width
/// of the vectors: elementwise, or with a fixed number of partial sums, so that every clone gives
/// the same bits (contraction is off).
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define FELTMB_CLONES __attribute__((target_clones("avx2", "default"), optimize("O3")))
#else
#define FELTMB_CLONES
#endif
