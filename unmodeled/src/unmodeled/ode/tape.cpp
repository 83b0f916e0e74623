// Integration of programs (program.py) for several simulations together, with derivatives.
//
// The algorithm is that of _in_numpy in step.py. A register holds one number for each of W
// simulations, so that the compiler vectorizes every operation. No library is needed, and there is
// no state: a call depends on its arguments alone. Multiplications and additions are not
// contracted (-ffp-contract=off), so that all machines give the same numbers.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#if defined(_WIN32)
#define EXPORT extern "C" __declspec(dllexport)
#else
#define EXPORT extern "C" __attribute__((visibility("default")))
#endif
#if defined(__GNUC__)
#define INLINE inline __attribute__((always_inline))
#else
#define INLINE inline
#endif

namespace {

// Codes in the order of FUNCTIONS in tape.py.
enum Code : std::int32_t {
  add, subtract, multiply, divide, negative, absolute, minimum, maximum, power, square_root,
  exponential, logarithm, sine, cosine, tangent, arc_sine, arc_cosine, arc_tangent, arc_tangent2,
  hyperbolic_sine, hyperbolic_cosine, hyperbolic_tangent, sign, round_down, less, less_equal, equal,
  where, exponential_minus_1, logarithm_of_1_plus, interpolate, slope, codes
};

}  // namespace

namespace {

// Reads the numbers and places that compiled.py has put into two lists, in their order.
struct Reader {
  const std::int64_t* numbers;
  void* const* places;

  void read(std::int64_t& to) { to = *numbers++; }
  template <typename T>
  void read(T*& to) {
    to = static_cast<T*>(*places++);
  }
  template <typename... Fields>
  void all(Fields&... fields) {
    (read(fields), ...);
  }
};

struct Operations {
  std::int64_t count;
  const std::int32_t* rows;  // (code, register, three arguments)
};

struct Entries {
  std::int64_t count;
  const std::int32_t* rows;  // (row, column, register), or registers alone
};

struct Program {
  std::int64_t states, smooth, columns, signals, constants_of_jobs, registers, constants;
  const std::int32_t* constant_places;
  const double* constant_values;
  Operations once, rates, shown;
  const std::int64_t* table_sizes;
  const double* const* tables;  // knots, then values
  Entries rate, by_state, by_column, output, output_by_state, output_by_column;
  std::int64_t blocks;
  const std::int64_t* block_sizes;

  explicit Program(Reader& r) {
    r.all(states, smooth, columns, signals, constants_of_jobs, registers);
    r.all(constants, constant_places, constant_values);
    for (Operations* o : {&once, &rates, &shown}) r.all(o->count, o->rows);
    r.all(table_sizes, tables);
    for (Entries* e : {&rate, &by_state, &by_column, &output, &output_by_state, &output_by_column})
      r.all(e->count, e->rows);
    r.all(blocks, block_sizes);
  }
};

struct Method {
  std::int64_t stages, substeps;
  const double *inner, *carried, *weights, *implicit;
  const std::int64_t* instants;
  double gamma;

  explicit Method(Reader& r) {
    r.all(stages, substeps, inner, carried, weights, implicit, instants);
    gamma = *implicit;
  }
};

struct Lanes {
  std::int64_t count;
  const std::int64_t* samples;    // by lane
  const double* const* times;     // by lane
  const double* const* signals;   // by lane: (samples, 2 substeps + 1, signals)
  const double *constants;        // (constants of jobs, lanes)
  const double *starts;           // (states, lanes)
  const double *seeds;            // (smooth, columns)
  double* const* outputs;         // by lane: (samples, outputs)
  double* const* derivatives;     // by lane: (samples, outputs, columns)
  double* const* paths;           // by lane: (samples, states)

  explicit Lanes(Reader& r) {
    r.all(count, samples, times, signals, constants, starts, seeds, outputs, derivatives, paths);
  }
};

double interpolated(double x, std::int64_t n, const double* knots) {
  const double* values = knots + n;
  if (!(x > knots[0])) return std::isnan(x) ? x : values[0];
  if (x >= knots[n - 1]) return values[n - 1];
  const std::int64_t i = std::upper_bound(knots, knots + n, x) - knots - 1;
  return (values[i + 1] - values[i]) / (knots[i + 1] - knots[i]) * (x - knots[i]) + values[i];
}

double slope_of(double x, std::int64_t n, const double* knots) {
  const double* values = knots + n;
  if (!(x >= knots[0] && x < knots[n - 1])) return 0.0;
  const std::int64_t i = std::upper_bound(knots, knots + n, x) - knots - 1;
  return (values[i + 1] - values[i]) / (knots[i + 1] - knots[i]);
}

// As np.minimum and np.maximum: NaN if one of both is NaN.
INLINE double lower_of(double a, double b) { return (a <= b || a != a) ? a : b; }
INLINE double upper_of(double a, double b) { return (a >= b || a != a) ? a : b; }

#define EACH for (int w = 0; w < W; ++w)

template <int W>
INLINE void operate(const Program& p, const Operations& code, double* registers) {
  const auto reg = [=](std::int64_t i) { return registers + i * W; };
  const std::int32_t* row = code.rows;
  for (std::int64_t n = 0; n < code.count; ++n, row += 5) {
    double* __restrict out = reg(row[1]);
    const double* a = reg(row[2]);
    const bool tabulated = row[0] == interpolate || row[0] == slope;
    const double* b = tabulated ? a : reg(row[3]);
    const double* c = reg(row[4]);
    switch (row[0]) {
      case add: EACH out[w] = a[w] + b[w]; break;
      case subtract: EACH out[w] = a[w] - b[w]; break;
      case multiply: EACH out[w] = a[w] * b[w]; break;
      case divide: EACH out[w] = a[w] / b[w]; break;
      case negative: EACH out[w] = -a[w]; break;
      case absolute: EACH out[w] = std::fabs(a[w]); break;
      case minimum: EACH out[w] = lower_of(a[w], b[w]); break;
      case maximum: EACH out[w] = upper_of(a[w], b[w]); break;
      case power: EACH out[w] = std::pow(a[w], b[w]); break;
      case square_root: EACH out[w] = std::sqrt(a[w]); break;
      case exponential: EACH out[w] = std::exp(a[w]); break;
      case logarithm: EACH out[w] = std::log(a[w]); break;
      case sine: EACH out[w] = std::sin(a[w]); break;
      case cosine: EACH out[w] = std::cos(a[w]); break;
      case tangent: EACH out[w] = std::tan(a[w]); break;
      case arc_sine: EACH out[w] = std::asin(a[w]); break;
      case arc_cosine: EACH out[w] = std::acos(a[w]); break;
      case arc_tangent: EACH out[w] = std::atan(a[w]); break;
      case arc_tangent2: EACH out[w] = std::atan2(a[w], b[w]); break;
      case hyperbolic_sine: EACH out[w] = std::sinh(a[w]); break;
      case hyperbolic_cosine: EACH out[w] = std::cosh(a[w]); break;
      case hyperbolic_tangent: EACH out[w] = std::tanh(a[w]); break;
      case sign: EACH out[w] = a[w] > 0.0 ? 1.0 : a[w] < 0.0 ? -1.0 : a[w] == 0.0 ? 0.0 : a[w]; break;
      case round_down: EACH out[w] = std::floor(a[w]); break;
      case less: EACH out[w] = a[w] < b[w] ? 1.0 : 0.0; break;
      case less_equal: EACH out[w] = a[w] <= b[w] ? 1.0 : 0.0; break;
      case equal: EACH out[w] = a[w] == b[w] ? 1.0 : 0.0; break;
      case where: EACH out[w] = a[w] != 0.0 ? b[w] : c[w]; break;
      case exponential_minus_1: EACH out[w] = std::expm1(a[w]); break;
      case logarithm_of_1_plus: EACH out[w] = std::log1p(a[w]); break;
      case interpolate:
        EACH out[w] = interpolated(a[w], p.table_sizes[row[3]], p.tables[row[3]]);
        break;
      case slope: EACH out[w] = slope_of(a[w], p.table_sizes[row[3]], p.tables[row[3]]); break;
      default: EACH out[w] = std::numeric_limits<double>::quiet_NaN();
    }
  }
}

// Not part of the caller, so that it is compiled once for each set of instructions.
template <int W>
void operate_here(const Program& p, const Operations& code, double* registers) {
  operate<W>(p, code, registers);
}

#if defined(__GNUC__) && defined(__x86_64__)
#define HAS_WIDE
template <int W>
__attribute__((target("avx2"), noinline)) void operate_wide(const Program& p,
                                                            const Operations& code,
                                                            double* registers) {
  operate<W>(p, code, registers);
}
#endif

template <int W, bool Wide>
class Block {
 public:
  Block(const Program& p, const Method& m) : p_(p), m_(m), registers_(p.registers * W) {
    const std::size_t state = p.states * W, slopes = p.smooth * p.columns * W;
    x_.resize(state);
    inner_.resize(state);
    k_.resize(m.stages * state);
    s_.resize(slopes);
    inner_slopes_.resize(slopes);
    d_.resize(m.stages * slopes);
    row_.resize(p.columns * W);
    matrix_.resize(m.gamma != 0.0 ? p.states * p.states * W : 0);
  }

  // Integrate the simulations `first` to `first + count`; further places repeat the last one.
  INLINE void run(const Lanes& lanes, std::int64_t first, std::int64_t count);

 private:
  void operate(const Operations& code) {
#if defined(HAS_WIDE)
    if constexpr (Wide) return operate_wide<W>(p_, code, registers_.data());
#endif
    operate_here<W>(p_, code, registers_.data());
  }
  INLINE void evaluate(const Lanes& lanes, const std::int64_t* lane, std::int64_t j,
                       std::int64_t half, const double* x, const double* h);
  INLINE void show(const Lanes& lanes, const std::int64_t* lane, std::int64_t count,
                   std::int64_t j);
  INLINE void factor();
  INLINE void solve(double* right, std::int64_t columns, std::int64_t blocks);
  double* reg(std::int64_t i) { return registers_.data() + i * W; }

  const Program& p_;
  const Method& m_;
  std::vector<double> registers_, x_, inner_, k_, s_, inner_slopes_, d_, row_, matrix_, work_;
  std::vector<double> factors_;
  std::vector<std::int32_t> pivots_;
};

// Rates at an instant between the samples j and j + 1.
template <int W, bool Wide>
INLINE void Block<W, Wide>::evaluate(const Lanes& lanes, const std::int64_t* lane, std::int64_t j,
                               std::int64_t half, const double* x, const double* h) {
  const std::int64_t halves = 2 * m_.substeps + 1;
  double* t = reg(0);
  double* signals = reg(1 + p_.states);
  EACH {
    const std::int64_t at = std::min(j, lanes.samples[lane[w]] - 1);
    t[w] = lanes.times[lane[w]][at] + 0.5 * double(half) * h[w];
    const double* own = lanes.signals[lane[w]] + (at * halves + half) * p_.signals;
    for (std::int64_t i = 0; i < p_.signals; ++i) signals[i * W + w] = own[i];
  }
  std::memcpy(reg(1), x, p_.states * W * sizeof(double));
  operate(p_.rates);
}

// Write outputs, derivatives and states at the sample j.
template <int W, bool Wide>
INLINE void Block<W, Wide>::show(const Lanes& lanes, const std::int64_t* lane, std::int64_t count,
                           std::int64_t j) {
  operate(p_.shown);
  const std::int64_t columns = p_.columns;
  for (std::int64_t o = 0; o < p_.output.count; ++o) {
    const double* y = reg(p_.output.rows[o]);
    for (std::int64_t w = 0; w < count; ++w)
      if (j < lanes.samples[lane[w]]) lanes.outputs[lane[w]][j * p_.output.count + o] = y[w];
    if (columns == 0) continue;
    double* __restrict row = row_.data();
    std::fill(row_.begin(), row_.end(), 0.0);
    for (std::int64_t n = 0; n < p_.output_by_state.count; ++n) {
      const std::int32_t* entry = p_.output_by_state.rows + 3 * n;
      if (entry[0] != o || entry[1] >= p_.smooth) continue;
      const double* share = reg(entry[2]);
      const double* s = s_.data() + entry[1] * columns * W;
      for (std::int64_t k = 0; k < columns; ++k) EACH row[k * W + w] += share[w] * s[k * W + w];
    }
    for (std::int64_t n = 0; n < p_.output_by_column.count; ++n) {
      const std::int32_t* entry = p_.output_by_column.rows + 3 * n;
      if (entry[0] != o) continue;
      const double* own = reg(entry[2]);
      EACH row[entry[1] * W + w] += own[w];
    }
    for (std::int64_t w = 0; w < count; ++w) {
      if (j >= lanes.samples[lane[w]]) continue;
      double* out = lanes.derivatives[lane[w]] + (j * p_.output.count + o) * columns;
      for (std::int64_t k = 0; k < columns; ++k) out[k] = row[k * W + w];
    }
  }
  for (std::int64_t w = 0; w < count; ++w)
    if (j < lanes.samples[lane[w]])
      for (std::int64_t i = 0; i < p_.states; ++i)
        lanes.paths[lane[w]][j * p_.states + i] = x_[i * W + w];
}

// Factor the diagonal blocks of the matrix, each with its own row exchanges.
template <int W, bool Wide>
INLINE void Block<W, Wide>::factor() {
  const std::int64_t size = p_.states;
  factors_ = matrix_;
  pivots_.assign(size * W, 0);
  double* f = factors_.data();
  for (std::int64_t b = 0, first = 0; b < p_.blocks; first += p_.block_sizes[b++]) {
    const std::int64_t end = first + p_.block_sizes[b];
    EACH for (std::int64_t c = first; c < end; ++c) {
      std::int64_t best = c;
      for (std::int64_t r = c + 1; r < end; ++r)
        if (std::fabs(f[(r * size + c) * W + w]) > std::fabs(f[(best * size + c) * W + w])) best = r;
      pivots_[c * W + w] = std::int32_t(best);
      if (best != c)
        for (std::int64_t k = first; k < end; ++k)
          std::swap(f[(c * size + k) * W + w], f[(best * size + k) * W + w]);
      for (std::int64_t r = c + 1; r < end; ++r) {
        const double share = f[(r * size + c) * W + w] /= f[(c * size + c) * W + w];
        for (std::int64_t k = c + 1; k < end; ++k)
          f[(r * size + k) * W + w] -= share * f[(c * size + k) * W + w];
      }
    }
  }
}

// Solve for right sides (states, columns, W), for the first blocks.
template <int W, bool Wide>
INLINE void Block<W, Wide>::solve(double* right, std::int64_t columns, std::int64_t blocks) {
  const std::int64_t size = p_.states, lead = p_.block_sizes[0], stride = columns * W;
  const double* f = factors_.data();
  for (std::int64_t b = 0, first = 0; b < blocks; first += p_.block_sizes[b++]) {
    const std::int64_t end = first + p_.block_sizes[b];
    if (b > 0)
      for (std::int64_t r = first; r < end; ++r)
        for (std::int64_t c = 0; c < lead; ++c)
          for (std::int64_t k = 0; k < columns; ++k)
            EACH right[r * stride + k * W + w] -=
                matrix_[(r * size + c) * W + w] * right[c * stride + k * W + w];
    for (std::int64_t c = first; c < end; ++c) {
      EACH {
        const std::int64_t other = pivots_[c * W + w];
        if (other != c)
          for (std::int64_t k = 0; k < columns; ++k)
            std::swap(right[c * stride + k * W + w], right[other * stride + k * W + w]);
      }
      for (std::int64_t r = c + 1; r < end; ++r)
        for (std::int64_t k = 0; k < columns; ++k)
          EACH right[r * stride + k * W + w] -=
              f[(r * size + c) * W + w] * right[c * stride + k * W + w];
    }
    for (std::int64_t c = end; c-- > first;)
      for (std::int64_t k = 0; k < columns; ++k) {
        EACH right[c * stride + k * W + w] /= f[(c * size + c) * W + w];
        for (std::int64_t r = first; r < c; ++r)
          EACH right[r * stride + k * W + w] -=
              f[(r * size + c) * W + w] * right[c * stride + k * W + w];
      }
  }
}

template <int W, bool Wide>
INLINE void Block<W, Wide>::run(const Lanes& lanes, std::int64_t first, std::int64_t count) {
  const std::int64_t states = p_.states, columns = p_.columns, width = columns * W;
  std::int64_t lane[W], longest = 0;
  EACH {
    lane[w] = first + std::min<std::int64_t>(w, count - 1);
    longest = std::max(longest, lanes.samples[lane[w]]);
  }
  std::fill(registers_.begin(), registers_.end(), 0.0);
  for (std::int64_t i = 0; i < p_.constants; ++i)
    EACH reg(p_.constant_places[i])[w] = p_.constant_values[i];
  double* own = reg(1 + states + p_.signals);
  for (std::int64_t i = 0; i < p_.constants_of_jobs; ++i)
    EACH own[i * W + w] = lanes.constants[i * lanes.count + lane[w]];
  for (std::int64_t i = 0; i < states; ++i)
    EACH x_[i * W + w] = lanes.starts[i * lanes.count + lane[w]];
  for (std::int64_t i = 0; i < p_.smooth * columns; ++i) EACH s_[i * W + w] = lanes.seeds[i];
  operate(p_.once);
  const double none[W] = {};
  const std::int64_t state = states * W, slopes = p_.smooth * width;
  for (std::int64_t j = 0; j < longest; ++j) {
    evaluate(lanes, lane, j, 0, x_.data(), none);
    show(lanes, lane, count, j);
    if (j == longest - 1) break;
    double h[W];
    EACH {
      const std::int64_t last = lanes.samples[lane[w]] - 1;
      const double* time = lanes.times[lane[w]];
      h[w] = (time[std::min(j + 1, last)] - time[std::min(j, last)]) / double(m_.substeps);
    }
    for (std::int64_t step = 0; step < m_.substeps; ++step) {
      for (std::int64_t stage = 0; stage < m_.stages; ++stage) {
        const double* shares = m_.inner + stage * m_.stages;
        const double* carried = m_.carried + stage * m_.stages;
        double* __restrict k = k_.data() + stage * state;
        if (step || stage) {
          for (std::int64_t i = 0; i < states; ++i) {
            double sum[W] = {};
            for (std::int64_t l = 0; l < stage; ++l)
              if (shares[l] != 0.0) EACH sum[w] += shares[l] * k_[l * state + i * W + w];
            EACH inner_[i * W + w] = x_[i * W + w] + h[w] * sum[w];
          }
          evaluate(lanes, lane, j, 2 * step + m_.instants[stage], inner_.data(), h);
        }
        if (stage == 0 && m_.gamma != 0.0) {
          std::fill(matrix_.begin(), matrix_.end(), 0.0);
          for (std::int64_t i = 0; i < states; ++i) EACH matrix_[(i * states + i) * W + w] = 1.0;
          for (std::int64_t n = 0; n < p_.by_state.count; ++n) {
            const std::int32_t* e = p_.by_state.rows + 3 * n;
            const double* value = reg(e[2]);
            EACH matrix_[(e[0] * states + e[1]) * W + w] -= m_.gamma * h[w] * value[w];
          }
          factor();
        }
        for (std::int64_t i = 0; i < states; ++i) {
          const double* value = reg(p_.rate.rows[i]);
          EACH k[i * W + w] = value[w];
          for (std::int64_t l = 0; l < stage; ++l)
            if (carried[l] != 0.0)
              EACH k[i * W + w] += carried[l] * k_[l * state + i * W + w];
        }
        if (m_.gamma != 0.0) solve(k, 1, p_.blocks);
        if (columns == 0) continue;
        double* __restrict d = d_.data() + stage * slopes;
        double* __restrict inner = inner_slopes_.data();
        std::int64_t parts = 0;
        for (std::int64_t l = 0; l < stage; ++l) {
          if (shares[l] == 0.0) continue;
          const double* other = d_.data() + l * slopes;
          const double share = shares[l];
          const bool begin = parts++ == 0;
          for (std::int64_t i = 0; i < p_.smooth * columns; ++i)
            EACH inner[i * W + w] = (begin ? 0.0 : inner[i * W + w]) + share * other[i * W + w];
        }
        for (std::int64_t i = 0; i < p_.smooth * columns; ++i)
          EACH inner[i * W + w] = s_[i * W + w] + (parts ? h[w] * inner[i * W + w] : 0.0);
        std::fill(d, d + slopes, 0.0);
        for (std::int64_t n = 0; n < p_.by_state.count; ++n) {
          const std::int32_t* e = p_.by_state.rows + 3 * n;
          if (e[0] >= p_.smooth || e[1] >= p_.smooth) continue;
          const double* share = reg(e[2]);
          double* __restrict row = d + e[0] * width;
          const double* from = inner + e[1] * width;
          for (std::int64_t c = 0; c < columns; ++c) EACH row[c * W + w] += share[w] * from[c * W + w];
        }
        for (std::int64_t n = 0; n < p_.by_column.count; ++n) {
          const std::int32_t* e = p_.by_column.rows + 3 * n;
          if (e[0] >= p_.smooth) continue;
          const double* value = reg(e[2]);
          EACH d[e[0] * width + e[1] * W + w] += value[w];
        }
        for (std::int64_t l = 0; l < stage; ++l)
          if (carried[l] != 0.0)
            for (std::int64_t i = 0; i < slopes; ++i) d[i] += carried[l] * d_[l * slopes + i];
        if (m_.gamma != 0.0) solve(d, columns, 1);
      }
      for (std::int64_t i = 0; i < states; ++i) {
        double sum[W] = {};
        for (std::int64_t l = 0; l < m_.stages; ++l)
          EACH sum[w] += m_.weights[l] * k_[l * state + i * W + w];
        EACH x_[i * W + w] += h[w] * sum[w];
      }
      for (std::int64_t i = 0; i < p_.smooth * columns; ++i) {
        double sum[W] = {};
        for (std::int64_t l = 0; l < m_.stages; ++l)
          EACH sum[w] += m_.weights[l] * d_[l * slopes + i * W + w];
        EACH s_[i * W + w] += h[w] * sum[w];
      }
    }
  }
}

template <int W, bool Wide>
INLINE void all_blocks(const Program& p, const Method& m, const Lanes& lanes) {
  Block<W, Wide> block(p, m);
  for (std::int64_t first = 0; first < lanes.count; first += W)
    block.run(lanes, first, std::min<std::int64_t>(W, lanes.count - first));
}

template <bool Wide>
INLINE void any_width(const Program& p, const Method& m, const Lanes& lanes) {
  if (lanes.count <= 4)
    all_blocks<4, Wide>(p, m, lanes);
  else
    all_blocks<8, Wide>(p, m, lanes);
}

#if defined(HAS_WIDE)
__attribute__((target("avx2"))) void with_avx2(const Program& p, const Method& m, const Lanes& l) {
  any_width<true>(p, m, l);
}
#endif

}  // namespace

// Version of the lists, and number of the operations.
EXPORT std::int64_t tape_version() { return 100 * 2 + codes; }

EXPORT void tape_run(const std::int64_t* numbers, void* const* places) {
  Reader reader{numbers, places};
  const Program program(reader);
  const Method method(reader);
  const Lanes lanes(reader);
#if defined(HAS_WIDE)
  if (__builtin_cpu_supports("avx2")) return with_avx2(program, method, lanes);
#endif
  any_width<false>(program, method, lanes);
}
