/* The device as a co-simulation FMU 2.0. */
#include "fmi2Functions.h"

typedef struct instance {
    device_state state;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    char name[];
} instance;

static int tell(const instance *d, int status, const char *line) {
    if (d->logger)
        d->logger(d->environment, d->name, (fmi2Status)status, status == REFUSED ? "logStatusDiscard" : "logStatusError",
                  line);
    return status;
}

#define D ((instance *)c)
#define STATE (&((instance *)c)->state)

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t count, const fmi2String categories[]) {
    (void)c, (void)on, (void)count, (void)categories; /* only what is refused is logged, and always */
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    instance *d;
    (void)resources, (void)visible, (void)logging;
    if (!name || !token) return NULL;
    d = calloc(1, sizeof *d + strlen(name) + 1);
    if (!d) return NULL;
    memcpy(d->name, name, strlen(name) + 1);
    if (functions) {
        d->logger = functions->logger;
        d->environment = functions->componentEnvironment;
    }
    device_reset(&d->state);
    if (type != fmi2CoSimulation) tell(d, FAILED, "instantiate: this FMU is for co-simulation only");
    else if (strcmp(token, HYSTMPC_TOKEN) != 0) tell(d, FAILED, "instantiate: the guid is of another FMU");
    else return d;
    free(d);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance, fmi2Real start_s,
                               fmi2Boolean stops, fmi2Real stop_s) {
    (void)tolerant, (void)tolerance; /* the steps are exact */
    return (fmi2Status)device_start(D, STATE, start_s, stops ? stop_s : INFINITY);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return (fmi2Status)device_enter(D, STATE, MADE, STARTING); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return (fmi2Status)device_enter(D, STATE, STARTING, RUNNING); }
fmi2Status fmi2Terminate(fmi2Component c) { return (fmi2Status)device_enter(D, STATE, RUNNING, ENDED); }

fmi2Status fmi2Reset(fmi2Component c) {
    device_reset(STATE);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference which[], size_t count, fmi2Real values[]) {
    return (fmi2Status)device_get(D, STATE, which, count, values);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference which[], size_t count, const fmi2Real values[]) {
    return (fmi2Status)device_set(D, STATE, which, count, values);
}

/* There are no variables of other types: a list of none is all that can be asked for. */
#define NO_VARIABLES(type)                                                                                            \
    fmi2Status fmi2Get##type(fmi2Component c, const fmi2ValueReference w[], size_t count, fmi2##type values[]) {       \
        (void)w, (void)values;                                                                                        \
        return count ? (fmi2Status)tell(D, FAILED, "get: this FMU has no " #type " variables") : fmi2OK;               \
    }                                                                                                                 \
    fmi2Status fmi2Set##type(fmi2Component c, const fmi2ValueReference w[], size_t count, const fmi2##type values[]) { \
        (void)w, (void)values;                                                                                        \
        return count ? (fmi2Status)tell(D, FAILED, "set: this FMU has no " #type " variables") : fmi2OK;               \
    }
NO_VARIABLES(Integer)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *copy) { return (fmi2Status)device_save(D, STATE, copy); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate copy) { return (fmi2Status)device_restore(D, STATE, copy); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *copy) {
    (void)c;
    free(*copy);
    *copy = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate copy, size_t *count) {
    (void)c, (void)copy;
    *count = STATE_BYTES;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate copy, fmi2Byte bytes[], size_t count) {
    return (fmi2Status)device_pack(D, copy, bytes, count);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t count, fmi2FMUstate *copy) {
    return (fmi2Status)device_unpack(D, bytes, count, copy);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns,
                                        const fmi2ValueReference known[], size_t knowns, const fmi2Real by[],
                                        fmi2Real change[]) {
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)by, (void)change;
    return (fmi2Status)tell(D, FAILED, "this FMU has no directional derivatives");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference w[], size_t count,
                                       const fmi2Integer order[], const fmi2Real values[]) {
    (void)w, (void)order, (void)values;
    return count ? (fmi2Status)tell(D, FAILED, "the command is held from step to step: it has no slope") : fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference w[], size_t count,
                                        const fmi2Integer order[], fmi2Real values[]) {
    (void)w, (void)order, (void)values;
    return count ? (fmi2Status)tell(D, FAILED, "this FMU has no derivatives of its output") : fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real at_s, fmi2Real length_s, fmi2Boolean forward) {
    (void)forward;
    return (fmi2Status)device_step(D, STATE, at_s, length_s);
}

fmi2Status fmi2CancelStep(fmi2Component c) { return (fmi2Status)tell(D, FAILED, "cancel: no step is under way"); }

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = device_time(STATE);
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    (void)c;
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
