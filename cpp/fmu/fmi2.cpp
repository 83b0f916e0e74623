/// The C functions of FMI 2.0 for co-simulation; those of model exchange refuse.
#include <cctype>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <memory>
#include <string>

#include "unit.hpp"

#define FMI2 extern "C" __attribute__((visibility("default")))

namespace {

using feltmb::fmu::open_unit;
using feltmb::fmu::Unit;

enum Status { kOk, kWarning, kDiscard, kError, kFatal, kPending };
constexpr int kCoSimulation = 1;

struct Callbacks {
  void (*log)(void* environment, const char* name, Status status, const char* category,
              const char* message, ...);
  void* (*allocate)(size_t, size_t);
  void (*free)(void*);
  void (*finished)(void*, Status);
  void* environment;
};

struct Instance {
  std::unique_ptr<Unit> unit;
  std::string name;
  Callbacks callbacks;
};
using State = std::vector<double>;

void tell(const Callbacks& to, const char* name, const char* message) {
  if (to.log != nullptr) to.log(to.environment, name, kError, "logStatusError", "%s", message);
}

template <class Work>
Status guarded(void* instance, Work&& work) {
  auto* own = static_cast<Instance*>(instance);
  if (own == nullptr) return kError;
  try {
    work(*own->unit);
    return kOk;
  } catch (const std::exception& error) {
    tell(own->callbacks, own->name.c_str(), error.what());
    return kError;
  }
}

/// Path of a URI of a file.
std::string path_of(const std::string& uri) {
  std::string text = uri.rfind("file:", 0) == 0 ? uri.substr(5) : uri;
  if (text.rfind("//", 0) == 0)
    text = text.substr(text.find('/', 2) == text.npos ? text.size() : text.find('/', 2));
  std::string out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const bool code = text[i] == '%' && i + 2 < text.size() &&
                      std::isxdigit(static_cast<unsigned char>(text[i + 1])) != 0 &&
                      std::isxdigit(static_cast<unsigned char>(text[i + 2])) != 0;
    out +=
        code ? static_cast<char>(std::strtol(text.substr(i + 1, 2).c_str(), nullptr, 16)) : text[i];
    if (code) i += 2;
  }
  return out;
}

}  // namespace

FMI2 const char* fmi2GetTypesPlatform() { return "default"; }
FMI2 const char* fmi2GetVersion() { return "2.0"; }
FMI2 Status fmi2SetDebugLogging(void*, int, size_t, const char* const*) { return kOk; }

FMI2 void* fmi2Instantiate(const char* name, int type, const char* token, const char* resources,
                           const Callbacks* callbacks, int, int) {
  const Callbacks none{};
  const Callbacks& to = callbacks == nullptr ? none : *callbacks;
  const char* own = name == nullptr ? "" : name;
  if (type != kCoSimulation) {
    tell(to, own, "this unit is for co-simulation only");
    return nullptr;
  }
  try {
    return new Instance{
        open_unit(path_of(resources == nullptr ? "" : resources), token == nullptr ? "" : token),
        own, to};
  } catch (const std::exception& error) {
    tell(to, own, error.what());
    return nullptr;
  }
}
FMI2 void fmi2FreeInstance(void* instance) { delete static_cast<Instance*>(instance); }

FMI2 Status fmi2SetupExperiment(void* instance, int has_tolerance, double tolerance, double start,
                                int, double) {
  return guarded(instance, [&](Unit& unit) {
    if (has_tolerance != 0) unit.set(feltmb::fmu::kTolerance, tolerance);
    unit.set_start(start);
  });
}
FMI2 Status fmi2EnterInitializationMode(void* instance) {
  return guarded(instance, [](Unit&) {});
}
FMI2 Status fmi2ExitInitializationMode(void* instance) {
  return guarded(instance, [](Unit& unit) { unit.initialize(); });
}
FMI2 Status fmi2Terminate(void* instance) {
  return guarded(instance, [](Unit&) {});
}
FMI2 Status fmi2Reset(void* instance) {
  return guarded(instance, [](Unit& unit) { unit.reset(); });
}

FMI2 Status fmi2GetReal(void* instance, const std::uint32_t* references, size_t count,
                        double* values) {
  return guarded(instance, [&](Unit& unit) {
    for (size_t i = 0; i < count; ++i) values[i] = unit.get(references[i]);
  });
}
FMI2 Status fmi2SetReal(void* instance, const std::uint32_t* references, size_t count,
                        const double* values) {
  return guarded(instance, [&](Unit& unit) {
    for (size_t i = 0; i < count; ++i) unit.set(references[i], values[i]);
  });
}

FMI2 Status fmi2DoStep(void* instance, double time, double duration, int) {
  return guarded(instance, [&](Unit& unit) { unit.step(time, duration); });
}

FMI2 Status fmi2GetFMUstate(void* instance, void** state) {
  return guarded(instance, [&](Unit& unit) {
    auto* own = static_cast<State*>(*state);
    if (own == nullptr) *state = own = new State;
    *own = unit.save();
  });
}
FMI2 Status fmi2SetFMUstate(void* instance, void* state) {
  return guarded(instance, [&](Unit& unit) { unit.restore(*static_cast<State*>(state)); });
}
FMI2 Status fmi2FreeFMUstate(void*, void** state) {
  delete static_cast<State*>(*state);
  *state = nullptr;
  return kOk;
}
FMI2 Status fmi2SerializedFMUstateSize(void*, void* state, size_t* size) {
  *size = static_cast<State*>(state)->size() * sizeof(double);
  return kOk;
}
FMI2 Status fmi2SerializeFMUstate(void*, void* state, char* bytes, size_t size) {
  const auto& own = *static_cast<State*>(state);
  if (size < own.size() * sizeof(double)) return kError;
  std::memcpy(bytes, own.data(), own.size() * sizeof(double));
  return kOk;
}
FMI2 Status fmi2DeSerializeFMUstate(void*, const char* bytes, size_t size, void** state) {
  if (size % sizeof(double) != 0) return kError;
  auto* own = new State(size / sizeof(double));
  std::memcpy(own->data(), bytes, size);
  *state = own;
  return kOk;
}

FMI2 Status fmi2GetRealStatus(void* instance, int what, double* value) {
  constexpr int kLastSuccessfulTime = 2;
  if (what != kLastSuccessfulTime) return kDiscard;
  return guarded(instance, [&](Unit& unit) { *value = unit.time(); });
}

// What this unit does not have. The arguments do not matter to a C function that refuses.
#define REFUSE(name) \
  FMI2 Status name(void* instance) { return instance == nullptr ? kError : kDiscard; }
REFUSE(fmi2GetInteger)
REFUSE(fmi2GetBoolean)
REFUSE(fmi2GetString)
REFUSE(fmi2SetInteger)
REFUSE(fmi2SetBoolean)
REFUSE(fmi2SetString)
REFUSE(fmi2GetDirectionalDerivative)
REFUSE(fmi2EnterEventMode)
REFUSE(fmi2NewDiscreteStates)
REFUSE(fmi2EnterContinuousTimeMode)
REFUSE(fmi2CompletedIntegratorStep)
REFUSE(fmi2SetTime)
REFUSE(fmi2SetContinuousStates)
REFUSE(fmi2GetDerivatives)
REFUSE(fmi2GetEventIndicators)
REFUSE(fmi2GetContinuousStates)
REFUSE(fmi2GetNominalsOfContinuousStates)
REFUSE(fmi2SetRealInputDerivatives)
REFUSE(fmi2GetRealOutputDerivatives)
REFUSE(fmi2CancelStep)
REFUSE(fmi2GetStatus)
REFUSE(fmi2GetIntegerStatus)
REFUSE(fmi2GetBooleanStatus)
REFUSE(fmi2GetStringStatus)
