/* The device as a co-simulation FMU 3.0. */
#include "fmi3Functions.h"

typedef struct instance {
    device_state state;
    fmi3LogMessageCallback logger;
    fmi3InstanceEnvironment environment;
} instance;

static int tell(const instance *d, int status, const char *line) {
    if (d->logger)
        d->logger(d->environment, (fmi3Status)status, status == REFUSED ? "logStatusDiscard" : "logStatusError", line);
    return status;
}

#define D ((instance *)c)
#define STATE (&((instance *)c)->state)

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t count, const fmi3String categories[]) {
    (void)c, (void)on, (void)count, (void)categories; /* only what is refused is logged, and always */
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference intermediate[], size_t intermediates,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                         fmi3IntermediateUpdateCallback update) {
    instance *d;
    (void)name, (void)resources, (void)visible, (void)logging, (void)early, (void)intermediate, (void)update;
    if (!token) return NULL;
    d = calloc(1, sizeof *d);
    if (!d) return NULL;
    d->logger = logger;
    d->environment = environment;
    device_reset(&d->state);
    if (events) tell(d, FAILED, "instantiate: this FMU has no event mode");
    else if (intermediates) tell(d, FAILED, "instantiate: this FMU has no intermediate variables");
    else if (strcmp(token, HYSTMPC_TOKEN) != 0) tell(d, FAILED, "instantiate: the token is of another FMU");
    else return d;
    free(d);
    return NULL;
}

void fmi3FreeInstance(fmi3Instance c) { free(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerant, fmi3Float64 tolerance, fmi3Float64 start_s,
                                       fmi3Boolean stops, fmi3Float64 stop_s) {
    (void)tolerant, (void)tolerance; /* the steps are exact */
    const int status = device_start(D, STATE, start_s, stops ? stop_s : INFINITY);
    return (fmi3Status)(status ? status : device_enter(D, STATE, MADE, STARTING));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return (fmi3Status)device_enter(D, STATE, STARTING, RUNNING); }
fmi3Status fmi3Terminate(fmi3Instance c) { return (fmi3Status)device_enter(D, STATE, RUNNING, ENDED); }

fmi3Status fmi3Reset(fmi3Instance c) {
    device_reset(STATE);
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference which[], size_t count, fmi3Float64 values[],
                          size_t room) {
    if (room != count) return (fmi3Status)tell(D, FAILED, "get: every variable of this FMU is a scalar");
    return (fmi3Status)device_get(D, STATE, which, count, values);
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference which[], size_t count, const fmi3Float64 values[],
                          size_t given) {
    if (given != count) return (fmi3Status)tell(D, FAILED, "set: every variable of this FMU is a scalar");
    return (fmi3Status)device_set(D, STATE, which, count, values);
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *copy) { return (fmi3Status)device_save(D, STATE, copy); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState copy) { return (fmi3Status)device_restore(D, STATE, copy); }

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *copy) {
    (void)c;
    free(*copy);
    *copy = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState copy, size_t *count) {
    (void)c, (void)copy;
    *count = STATE_BYTES;
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState copy, fmi3Byte bytes[], size_t count) {
    return (fmi3Status)device_pack(D, copy, bytes, count);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t count, fmi3FMUState *copy) {
    return (fmi3Status)device_unpack(D, bytes, count, copy);
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 at_s, fmi3Float64 length_s, fmi3Boolean forward, fmi3Boolean *event,
                      fmi3Boolean *ends, fmi3Boolean *early, fmi3Float64 *reached_s) {
    (void)forward;
    const int status = device_step(D, STATE, at_s, length_s);
    *event = *ends = *early = fmi3False;
    *reached_s = device_time(STATE);
    return (fmi3Status)status;
}

/* There are no variables of other types: a list of none is all that can be asked for. */
#define NONE(text) return count ? (fmi3Status)tell(D, FAILED, text) : fmi3OK
#define NO_VARIABLES(type)                                                                                           \
    fmi3Status fmi3Get##type(fmi3Instance c, const fmi3ValueReference w[], size_t count, fmi3##type v[], size_t n) {  \
        (void)w, (void)v, (void)n;                                                                                   \
        NONE("get: this FMU has no " #type " variables");                                                            \
    }                                                                                                                \
    fmi3Status fmi3Set##type(fmi3Instance c, const fmi3ValueReference w[], size_t count, const fmi3##type v[],        \
                             size_t n) {                                                                             \
        (void)w, (void)v, (void)n;                                                                                   \
        NONE("set: this FMU has no " #type " variables");                                                            \
    }
NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(Int32)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference w[], size_t count, size_t sizes[], fmi3Binary v[],
                         size_t n) {
    (void)w, (void)sizes, (void)v, (void)n;
    NONE("get: this FMU has no Binary variables");
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference w[], size_t count, const size_t sizes[],
                         const fmi3Binary v[], size_t n) {
    (void)w, (void)sizes, (void)v, (void)n;
    NONE("set: this FMU has no Binary variables");
}

/* Functions on clocks, by what they take beside the references. */
#define NO_CLOCK(name, taken, unused)                                                        \
    fmi3Status fmi3##name(fmi3Instance c, const fmi3ValueReference w[], size_t count, taken) { \
        (void)w, unused;                                                                     \
        NONE("this FMU has no clocks");                                                      \
    }
#define AND ,
NO_CLOCK(GetClock, fmi3Clock v[], (void)v)
NO_CLOCK(SetClock, const fmi3Clock v[], (void)v)
NO_CLOCK(GetIntervalDecimal, fmi3Float64 v[] AND fmi3IntervalQualifier q[], (void)v AND (void)q)
NO_CLOCK(GetIntervalFraction, fmi3UInt64 v[] AND fmi3UInt64 r[] AND fmi3IntervalQualifier q[],
         (void)v AND (void)r AND (void)q)
NO_CLOCK(GetShiftDecimal, fmi3Float64 v[], (void)v)
NO_CLOCK(GetShiftFraction, fmi3UInt64 v[] AND fmi3UInt64 r[], (void)v AND (void)r)
NO_CLOCK(SetIntervalDecimal, const fmi3Float64 v[], (void)v)
NO_CLOCK(SetIntervalFraction, const fmi3UInt64 v[] AND const fmi3UInt64 r[], (void)v AND (void)r)
NO_CLOCK(SetShiftDecimal, const fmi3Float64 v[], (void)v)
NO_CLOCK(SetShiftFraction, const fmi3UInt64 v[] AND const fmi3UInt64 r[], (void)v AND (void)r)

/* Modes and calls that modelDescription.xml does not offer. */
#define NOT_OFFERED(name) \
    fmi3Status fmi3##name(fmi3Instance c) { return (fmi3Status)tell(D, FAILED, #name ": not offered by this FMU"); }
NOT_OFFERED(EnterEventMode)
NOT_OFFERED(EnterStepMode)
NOT_OFFERED(EnterConfigurationMode)
NOT_OFFERED(ExitConfigurationMode)
NOT_OFFERED(EvaluateDiscreteStates)

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *ends, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *scheduled, fmi3Float64 *time_s) {
    (void)again, (void)ends, (void)nominals, (void)values, (void)scheduled, (void)time_s;
    return (fmi3Status)tell(D, FAILED, "UpdateDiscreteStates: not offered by this FMU");
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference w[], size_t count, const fmi3Int32 order[],
                                    fmi3Float64 v[], size_t n) {
    (void)w, (void)order, (void)v, (void)n;
    NONE("this FMU has no derivatives of its output");
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference which, size_t *count) {
    (void)which, (void)count;
    return (fmi3Status)tell(D, FAILED, "GetNumberOfVariableDependencies: not offered by this FMU");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference which, size_t of[], fmi3ValueReference on[],
                                       size_t at[], fmi3DependencyKind kinds[], size_t count) {
    (void)which, (void)of, (void)on, (void)at, (void)kinds, (void)count;
    return (fmi3Status)tell(D, FAILED, "GetVariableDependencies: not offered by this FMU");
}

#define NO_DERIVATIVE(name)                                                                              \
    fmi3Status fmi3##name(fmi3Instance c, const fmi3ValueReference unknown[], size_t unknowns,             \
                          const fmi3ValueReference known[], size_t knowns, const fmi3Float64 seed[],       \
                          size_t seeds, fmi3Float64 change[], size_t changes) {                            \
        (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)seed, (void)seeds, (void)change;   \
        (void)changes;                                                                                   \
        return (fmi3Status)tell(D, FAILED, #name ": not offered by this FMU");                           \
    }
NO_DERIVATIVE(GetDirectionalDerivative)
NO_DERIVATIVE(GetAdjointDerivative)

/* Model exchange and scheduled execution: every function is there, as loaders ask for all, and none is offered. */
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback logger) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    if (logger) logger(environment, fmi3Error, "logStatusError", "instantiate: this FMU is for co-simulation only");
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
    (void)update, (void)lock, (void)unlock;
    return fmi3InstantiateModelExchange(name, token, resources, visible, logging, environment, logger);
}

NOT_OFFERED(EnterContinuousTimeMode)

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean forward, fmi3Boolean *event, fmi3Boolean *ends) {
    (void)forward, (void)event, (void)ends;
    return (fmi3Status)tell(D, FAILED, "CompletedIntegratorStep: not offered by this FMU");
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time_s) {
    (void)time_s;
    return (fmi3Status)tell(D, FAILED, "SetTime: not offered by this FMU");
}

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 v[], size_t count) {
    (void)v;
    NONE("this FMU has no continuous states");
}

#define NO_CONTINUOUS(name)                                                  \
    fmi3Status fmi3##name(fmi3Instance c, fmi3Float64 v[], size_t count) {     \
        (void)v;                                                             \
        NONE(#name ": this FMU has no continuous states");                   \
    }
NO_CONTINUOUS(GetContinuousStateDerivatives)
NO_CONTINUOUS(GetEventIndicators)
NO_CONTINUOUS(GetContinuousStates)
NO_CONTINUOUS(GetNominalsOfContinuousStates)

#define COUNT_ZERO(name)                                            \
    fmi3Status fmi3##name(fmi3Instance c, size_t *count) {            \
        (void)c;                                                    \
        *count = 0;                                                 \
        return fmi3OK;                                              \
    }
COUNT_ZERO(GetNumberOfEventIndicators)
COUNT_ZERO(GetNumberOfContinuousStates)

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time_s) {
    (void)clock, (void)time_s;
    return (fmi3Status)tell(D, FAILED, "ActivateModelPartition: not offered by this FMU");
}
