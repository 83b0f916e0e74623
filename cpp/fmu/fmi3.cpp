/// The C functions of FMI 3.0 for co-simulation; those of other kinds of unit refuse.
#include <cstdint>
#include <cstring>
#include <exception>
#include <memory>

#include "unit.hpp"

#define FMI3 extern "C" __attribute__((visibility("default")))

namespace {

using feltmb::fmu::open_unit;
using feltmb::fmu::Unit;

enum Status { kOk, kWarning, kDiscard, kError, kFatal };
using Log = void (*)(void* environment, Status status, const char* category, const char* message);

struct Instance {
  std::unique_ptr<Unit> unit;
  void* environment;
  Log log;
};
using State = std::vector<double>;

template <class Work>
Status guarded(void* instance, Work&& work) {
  auto* own = static_cast<Instance*>(instance);
  if (own == nullptr) return kError;
  try {
    work(*own->unit);
    return kOk;
  } catch (const std::exception& error) {
    if (own->log != nullptr) own->log(own->environment, kError, "logStatusError", error.what());
    return kError;
  }
}

}  // namespace

FMI3 const char* fmi3GetVersion() { return "3.0"; }
FMI3 Status fmi3SetDebugLogging(void*, bool, size_t, const char* const*) { return kOk; }

FMI3 void* fmi3InstantiateCoSimulation(const char*, const char* token, const char* resources, bool,
                                       bool, bool, bool, const std::uint32_t*, size_t,
                                       void* environment, Log log, void*) {
  try {
    return new Instance{
        open_unit(resources == nullptr ? "" : resources, token == nullptr ? "" : token),
        environment, log};
  } catch (const std::exception& error) {
    if (log != nullptr) log(environment, kError, "logStatusError", error.what());
    return nullptr;
  }
}
FMI3 void* fmi3InstantiateModelExchange(const char*, const char*, const char*, bool, bool, void*,
                                        Log) {
  return nullptr;
}
FMI3 void* fmi3InstantiateScheduledExecution(const char*, const char*, const char*, bool, bool,
                                             void*, Log, void*, void*, void*) {
  return nullptr;
}
FMI3 void fmi3FreeInstance(void* instance) { delete static_cast<Instance*>(instance); }

FMI3 Status fmi3EnterInitializationMode(void* instance, bool has_tolerance, double tolerance,
                                        double start, bool, double) {
  return guarded(instance, [&](Unit& unit) {
    if (has_tolerance) unit.set(feltmb::fmu::kTolerance, tolerance);
    unit.set_start(start);
  });
}
FMI3 Status fmi3ExitInitializationMode(void* instance) {
  return guarded(instance, [](Unit& unit) { unit.initialize(); });
}
FMI3 Status fmi3Terminate(void* instance) {
  return guarded(instance, [](Unit&) {});
}
FMI3 Status fmi3Reset(void* instance) {
  return guarded(instance, [](Unit& unit) { unit.reset(); });
}

FMI3 Status fmi3GetFloat64(void* instance, const std::uint32_t* references, size_t count,
                           double* values, size_t) {
  return guarded(instance, [&](Unit& unit) {
    for (size_t i = 0; i < count; ++i) values[i] = unit.get(references[i]);
  });
}
FMI3 Status fmi3SetFloat64(void* instance, const std::uint32_t* references, size_t count,
                           const double* values, size_t) {
  return guarded(instance, [&](Unit& unit) {
    for (size_t i = 0; i < count; ++i) unit.set(references[i], values[i]);
  });
}

FMI3 Status fmi3DoStep(void* instance, double time, double duration, bool, bool* event,
                       bool* terminate, bool* early, double* reached) {
  if (event != nullptr) *event = false;
  if (terminate != nullptr) *terminate = false;
  if (early != nullptr) *early = false;
  const Status status = guarded(instance, [&](Unit& unit) { unit.step(time, duration); });
  if (reached != nullptr && instance != nullptr) {
    *reached = static_cast<Instance*>(instance)->unit->time();
  }
  return status;
}

FMI3 Status fmi3GetFMUState(void* instance, void** state) {
  return guarded(instance, [&](Unit& unit) {
    auto* own = static_cast<State*>(*state);
    if (own == nullptr) *state = own = new State;
    *own = unit.save();
  });
}
FMI3 Status fmi3SetFMUState(void* instance, void* state) {
  return guarded(instance, [&](Unit& unit) { unit.restore(*static_cast<State*>(state)); });
}
FMI3 Status fmi3FreeFMUState(void*, void** state) {
  delete static_cast<State*>(*state);
  *state = nullptr;
  return kOk;
}
FMI3 Status fmi3SerializedFMUStateSize(void*, void* state, size_t* size) {
  *size = static_cast<State*>(state)->size() * sizeof(double);
  return kOk;
}
FMI3 Status fmi3SerializeFMUState(void*, void* state, std::uint8_t* bytes, size_t size) {
  const auto& own = *static_cast<State*>(state);
  if (size < own.size() * sizeof(double)) return kError;
  std::memcpy(bytes, own.data(), own.size() * sizeof(double));
  return kOk;
}
FMI3 Status fmi3DeserializeFMUState(void*, const std::uint8_t* bytes, size_t size, void** state) {
  if (size % sizeof(double) != 0) return kError;
  auto* own = new State(size / sizeof(double));
  std::memcpy(own->data(), bytes, size);
  *state = own;
  return kOk;
}

FMI3 Status fmi3EnterStepMode(void* instance) {
  return guarded(instance, [](Unit&) {});
}

// What this unit does not have. The arguments do not matter to a C function that refuses.
#define REFUSE(name) \
  FMI3 Status name(void* instance) { return instance == nullptr ? kError : kDiscard; }
REFUSE(fmi3GetFloat32)
REFUSE(fmi3GetInt8)
REFUSE(fmi3GetUInt8)
REFUSE(fmi3GetInt16)
REFUSE(fmi3GetUInt16)
REFUSE(fmi3GetInt32)
REFUSE(fmi3GetUInt32)
REFUSE(fmi3GetInt64)
REFUSE(fmi3GetUInt64)
REFUSE(fmi3GetBoolean)
REFUSE(fmi3GetString)
REFUSE(fmi3GetBinary)
REFUSE(fmi3GetClock)
REFUSE(fmi3SetFloat32)
REFUSE(fmi3SetInt8)
REFUSE(fmi3SetUInt8)
REFUSE(fmi3SetInt16)
REFUSE(fmi3SetUInt16)
REFUSE(fmi3SetInt32)
REFUSE(fmi3SetUInt32)
REFUSE(fmi3SetInt64)
REFUSE(fmi3SetUInt64)
REFUSE(fmi3SetBoolean)
REFUSE(fmi3SetString)
REFUSE(fmi3SetBinary)
REFUSE(fmi3SetClock)
REFUSE(fmi3GetNumberOfVariableDependencies)
REFUSE(fmi3GetVariableDependencies)
REFUSE(fmi3GetDirectionalDerivative)
REFUSE(fmi3GetAdjointDerivative)
REFUSE(fmi3EnterConfigurationMode)
REFUSE(fmi3ExitConfigurationMode)
REFUSE(fmi3EnterEventMode)
REFUSE(fmi3GetIntervalDecimal)
REFUSE(fmi3GetIntervalFraction)
REFUSE(fmi3GetShiftDecimal)
REFUSE(fmi3GetShiftFraction)
REFUSE(fmi3SetIntervalDecimal)
REFUSE(fmi3SetIntervalFraction)
REFUSE(fmi3SetShiftDecimal)
REFUSE(fmi3SetShiftFraction)
REFUSE(fmi3EvaluateDiscreteStates)
REFUSE(fmi3UpdateDiscreteStates)
REFUSE(fmi3EnterContinuousTimeMode)
REFUSE(fmi3CompletedIntegratorStep)
REFUSE(fmi3SetTime)
REFUSE(fmi3SetContinuousStates)
REFUSE(fmi3GetContinuousStateDerivatives)
REFUSE(fmi3GetEventIndicators)
REFUSE(fmi3GetContinuousStates)
REFUSE(fmi3GetNominalsOfContinuousStates)
REFUSE(fmi3GetNumberOfEventIndicators)
REFUSE(fmi3GetNumberOfContinuousStates)
REFUSE(fmi3GetOutputDerivatives)
REFUSE(fmi3ActivateModelPartition)
