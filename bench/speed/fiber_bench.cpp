// Speed of the fiber module: pressure evaluations of every law, and the bead-spring simulation in
// fiber-steps a second against threads. Usage: fiber_bench [evaluations] [fibers] [steps]
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>
#include <thread>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/fiber/bead_spring.hpp"
#include "feltmb/fiber/compression.hpp"
#include "feltmb/fiber/orientation.hpp"

namespace {

double seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

const std::map<std::string, std::map<std::string, double>> kExamples = {
    {"van_wyk", {{"k_p", 0.01}, {"E", 2.5e9}, {"v_f0", 0.1}}},
    {"neckar", {{"k_p", 0.01}, {"E", 2.5e9}, {"v_f0", 0.1}, {"v_fm", 0.7}}},
    {"stamm", {{"k_p", 0.01}, {"E", 2.5e9}, {"v_f0", 0.1}, {"v_fm", 0.7}, {"w_f", 0.5}}},
    {"toll_planar", {{"E", 2.5e9}, {"v_f0", 0.1}}},
    {"narter", {{"E", 2.5e9}, {"v_f0", 0.1}, {"gamma", 1.3}}},
    {"alkhagen_toll", {{"E", 2.5e9}, {"v_f0", 0.1}, {"k_b", 1.0}, {"k_t", 1.0}, {"beta", 5.0}}},
    {"binomial", {{"K_p", 4e6}, {"gamma", 1.3}, {"v_f0", 0.1}}},
    {"bending_chain", {{"E", 2.5e9}, {"gamma", 1.3}, {"v_f0", 0.1}}},
    {"komori_itoh", {{"E", 2.5e9}, {"v_f0", 0.1}}},
    {"komori_itoh_renewed", {{"E", 2.5e9}, {"v_f0", 0.1}}},
    {"lee_carnaby", {{"E", 2.5e9}, {"v_f0", 0.1}, {"chord_ratio", 0.9}}}};

std::size_t argument(int argc, char** argv, int index, std::size_t otherwise) {
  if (argc <= index) return otherwise;
  const long long value = std::atoll(argv[index]);
  if (value < 1) throw feltmb::InvalidParameter("fiber_bench: arguments must be whole and > 0");
  return static_cast<std::size_t>(value);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const std::size_t count = argument(argc, argv, 1, 1000000);
    const std::size_t fibers = argument(argc, argv, 2, 200);
    const std::size_t steps = argument(argc, argv, 3, 400);
    const std::size_t cores = std::max(1U, std::thread::hardware_concurrency());
    std::vector<double> v(count);
    std::vector<double> p(count);
    for (std::size_t i = 0; i < count; ++i) {
      v[i] = 0.1 + 0.4 * static_cast<double>((i * 7919) % count) / static_cast<double>(count);
    }
    double start = seconds();
    feltmb::uniaxial_structure(2.0);
    std::printf("structure table, once            %10.4f s\n", seconds() - start);
    std::printf("%-24s %12s %12s %14s\n", "law", "make [ms]", "1 thread [s]", "checksum [Pa]");
    for (const auto& [name, parameters] : kExamples) {
      start = seconds();
      const auto law = feltmb::make_law(name, parameters);
      const double made = seconds();
      feltmb::evaluate_law(*law, feltmb::LawQuantity::pressure, v, p, 1);
      const double done = seconds();
      double sum = 0.0;
      for (double x : p) sum += x;
      std::printf("%-24s %12.3f %12.4f %14.9g\n", name.c_str(), 1e3 * (made - start), done - made,
                  sum / static_cast<double>(count));
    }
    feltmb::BeadSpringParams box;
    box.n_fibers = fibers;
    box.n_beads = 31;
    box.v_f = 0.1;
    box.crimp = 0.2;
    box.friction = 0.3;
    std::printf("%-24s %12s %16s %14s\n", "bead-spring, threads", "steps/s", "fiber-steps/s",
                "checksum [Pa]");
    for (std::size_t threads = 1; threads <= cores; ++threads) {
      feltmb::BeadSpringNetwork network(box, threads);
      network.relax(1500);
      start = seconds();
      network.advance(steps, 1e-5);
      const double rate = static_cast<double>(steps) / (seconds() - start);
      std::printf("%-24zu %12.1f %16.0f %14.9g\n", threads, rate,
                  rate * static_cast<double>(fibers), network.sample().pressure);
    }
  } catch (const feltmb::Error& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 2;
  }
  return 0;
}
