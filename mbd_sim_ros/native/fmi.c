/* fmi.c: a model as a unit of co-simulation, by the functions of FMI 2.0 and 3.0 (references.md: [FMI2014], [FMI2022]).
 *
 * Value references are the numbers of variables; behind them come the parameters of the filter of steering commands, the
 * time and the number of findings of the verdict. The model lies in resources/model.mbd; instantiation token and GUID are its digest. */
#include "mbd.c"

#include <stdarg.h>
#include <stdbool.h>

#define FMI __attribute__((visibility("default")))

typedef int status; /* of both versions */
enum { FMI_OK, FMI_WARNING, FMI_DISCARD, FMI_ERROR, FMI_FATAL };
enum { BANDWIDTH, RATE_LIMIT, TIME, FINDINGS, PARAMETERS = TIME }; /* behind the variables */
enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED };         /* run.mode, which is part of a state */

typedef void (*logger2)(void *environment, const char *instance, status, const char *category, const char *format, ...);
typedef void (*logger3)(void *environment, status, const char *category, const char *message);
typedef struct {
    logger2 logger;
    void *allocate, *free, *step_finished;
    void *environment;
} callbacks2;

typedef struct {
    mbd_model *model;
    char *name;
    int logging;
    void *environment;
    logger2 log2;
    logger3 log3;
} unit;

typedef struct {
    size_t size;
    char bytes[];
} saved;

/* A sentence goes to the log as its own format, each % doubled: importers that format and those that do not show it. */
static status say(const unit *u, status s, const char *sentence) {
    char doubled[1700];
    size_t n = 0;
    const char *category = s == FMI_OK ? "events" : s == FMI_WARNING ? "verdict" : "errors";
    if (s == FMI_OK && !u->logging) return s;
    for (const char *c = sentence; *c != 0 && n + 2 < sizeof doubled; c++) {
        if (*c == '%') doubled[n++] = '%';
        doubled[n++] = *c;
    }
    doubled[n] = 0;
    if (u->log2 != NULL) u->log2(u->environment, u->name, s, category, doubled);
    if (u->log3 != NULL) u->log3(u->environment, s, category, sentence);
    return s;
}

static status answered(const unit *u, int code) {
    if (code == MBD_OK) return FMI_OK;
    const char *message = mbd_message(u->model);
    return say(u, FMI_ERROR, message[0] ? message : mbd_text(code));
}

/* Whether a call is one for this mode; else a sentence. */
static bool in_mode(const unit *u, int64_t mode, const char *call) {
    static const char *const names[] = {"before its initialization", "in its initialization", "between steps", "at its end"};
    int64_t now = u->model->run->mode;
    char sentence[200];
    if (now == mode) return true;
    snprintf(sentence, sizeof sentence, "%s is for a unit %s, and this one is %s", call, names[mode], names[now]);
    return say(u, FMI_ERROR, sentence) == FMI_OK;
}

/* To another mode, from the one before it. */
static status to_mode(unit *u, int64_t mode, const char *call) {
    if (!in_mode(u, mode - 1, call)) return FMI_ERROR;
    u->model->run->mode = mode;
    return FMI_OK;
}

/* Whatever the verdict finds goes to the log, whether logging is on or not: who drives a unit must hear it. */
static status terminate(unit *u) {
    if (to_mode(u, TERMINATED, "terminate") != FMI_OK) return FMI_ERROR;
    for (int k = 0, n = u->model->run->k > 0 ? mbd_verdict(u->model) : 0; k < n; k++) say(u, FMI_WARNING, mbd_finding(u->model, k));
    return FMI_OK;
}

static void told(void *user, const char *sentence) { say(user, FMI_OK, sentence); }

/* -- making and freeing -------------------------------------------------------------------------------------------- */

static int digit(char c) {
    return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* Path of the model in a directory, which is a path or a URI file:... with %XX; NULL where it is another kind of place. */
static char *model_path(const char *directory) {
    static const char file[] = "/model.mbd";
    int uri = strncmp(directory, "file:", 5) == 0;
    if (uri) {
        directory += 5;
        if (strncmp(directory, "//", 2) == 0) directory = strchr(directory + 2, '/'); /* behind the host */
        if (directory == NULL) return NULL;
    }
    size_t length = strlen(directory);
    char *path = malloc(length + sizeof file), *to = path;
    if (path == NULL) return NULL;
    for (size_t k = 0; k < length; k++) {
        int high = uri && directory[k] == '%' ? digit(directory[k + 1]) : -1;
        int low = high >= 0 ? digit(directory[k + 2]) : -1;
        *to++ = low >= 0 ? (char)(16 * high + low) : directory[k];
        if (low >= 0) k += 2;
    }
    while (to > path && to[-1] == '/') to--;
    memcpy(to, file, sizeof file);
    return path;
}

static unit *refused(unit *u, const char *sentence) {
    say(u, FMI_ERROR, sentence);
    mbd_free(u->model);
    free(u->name);
    free(u);
    return NULL;
}

static unit *new_unit(const char *name, const char *token, const char *directory, int logging, void *environment, logger2 log2,
                      logger3 log3) {
    unit *u = calloc(1, sizeof *u);
    if (u == NULL) return NULL;
    u->logging = logging, u->environment = environment, u->log2 = log2, u->log3 = log3;
    size_t length = name == NULL ? 0 : strlen(name);
    if ((u->name = calloc(length + 1, 1)) == NULL) return refused(u, mbd_text(MBD_MEMORY));
    if (length > 0) memcpy(u->name, name, length);
    if (token == NULL || directory == NULL) return refused(u, "no GUID or token, or no place of the resources was given");
    char *path = model_path(directory);
    int code = path == NULL ? MBD_FILE : mbd_open(path, &u->model);
    free(path);
    if (code != MBD_OK) {
        char sentence[200];
        snprintf(sentence, sizeof sentence, "resources/model.mbd: %s", mbd_text(code));
        return refused(u, sentence);
    }
    char own[33];
    for (int k = 0; k < 16; k++) snprintf(own + 2 * k, 3, "%02x", (unsigned char)u->model->common->content[MAGIC + k]);
    if (strcmp(own, token) != 0)
        return refused(u, "the GUID or token is not that of resources/model.mbd: parts of two archives are mixed");
    mbd_log(u->model, told, u);
    return u;
}

static void free_unit(unit *u) {
    if (u == NULL) return;
    mbd_free(u->model);
    free(u->name);
    free(u);
}

/* -- values -------------------------------------------------------------------------------------------------------- */

static status get(const unit *u, const unsigned *references, size_t n, double *values) {
    int count = mbd_variables(u->model);
    const double *filter = (const double *)in_written(u->model, fields(u->model)[FILTER]);
    for (size_t k = 0; k < n; k++) {
        unsigned v = references[k];
        if (v < (unsigned)count) {
            const motion *moved;
            mbd_get(u->model, (int)v, &values[k]);
            int64_t input = mbd_kind(u->model, (int)v) == MBD_INPUT_KIND ? input_of(u->model, (int)v, &moved) : -1;
            if (input >= 0 && moved != NULL && moved->value == input && u->model->source[input] == FILTERED)
                values[k] = *(const double *)in_written(u->model, moved->state); /* what was commanded */
        } else if (v < (unsigned)count + PARAMETERS) values[k] = filter[v - (unsigned)count];
        else if (v == (unsigned)count + TIME) values[k] = 1e-9 * (double)u->model->run->start + mbd_time(u->model);
        else if (v == (unsigned)count + FINDINGS) values[k] = mbd_verdict(u->model);
        else return say(u, FMI_ERROR, "a value reference is not one of this unit");
    }
    return FMI_OK;
}

static status set(unit *u, const unsigned *references, size_t n, const double *values) {
    mbd_model *m = u->model;
    int count = mbd_variables(m);
    const double *filter = (const double *)in_written(m, fields(m)[FILTER]);
    if (m->run->mode == TERMINATED) return say(u, FMI_ERROR, "nothing can be set: the run has ended; reset the unit");
    for (size_t k = 0; k < n; k++) {
        unsigned v = references[k];
        int code = MBD_OK;
        if (v < (unsigned)count) {
            const motion *moved = NULL;
            int64_t input = input_of(m, (int)v, &moved);
            if (input < 0) code = MBD_ARGUMENT;
            else if (moved == NULL || moved->filtered) code = mbd_set(m, (int)v, values[k]);
            else { /* parts of a motion come one by one */
                double parts[3];
                for (int i = 0; i < 3; i++) parts[i] = (&moved->value)[i] == input ? values[k] : m->row[(&moved->value)[i]];
                code = mbd_set_motion(m, (int)v - (int)(input - moved->value), parts[0], parts[1], parts[2]);
            }
        } else if (v == (unsigned)count + BANDWIDTH) code = mbd_filter(m, values[k], filter[RATE_LIMIT]);
        else if (v == (unsigned)count + RATE_LIMIT) code = mbd_filter(m, filter[BANDWIDTH], values[k]);
        else return say(u, FMI_ERROR, "a value reference is not one of this unit that can be set");
        if (code != MBD_OK) return answered(u, code);
    }
    return FMI_OK;
}

/* -- time ---------------------------------------------------------------------------------------------------------- */

/* Seconds from 0 on that a time may have: 64 bits hold their nanoseconds, and not those of ten times as many. */
static const double FARTHEST = 9e9;

/* Whether a time that is `off` nanoseconds beside the grid of steps h counts as on it. Times of importers are sums of
 * rounded steps: 1 ns and a millionth of a step pass. Ten times as much would take 0.99999 ms for a step of 1 ms. */
static bool on_grid(int64_t off, int64_t h) { return llabs(off) <= 1 + h / 1000000; }

static status begin_at(unit *u, double start) {
    if (!in_mode(u, INSTANTIATED, "a start time")) return FMI_ERROR;
    if (!isfinite(start) || fabs(start) > FARTHEST) return say(u, FMI_ERROR, "the start time is not a time");
    u->model->run->start = llround(start * 1e9);
    return FMI_OK;
}

/* To the time now + step. What does not lie on the grid of steps is refused, and nothing is done. */
static status step_by(unit *u, double now, double step) {
    mbd_model *m = u->model;
    char sentence[300];
    int64_t h = mbd_h_ns(m), at = m->run->k * h + m->run->start;
    if (!in_mode(u, STEPPING, "a step")) return FMI_ERROR;
    if (!isfinite(now) || !isfinite(step) || fabs(now) > FARTHEST || fabs(step) > FARTHEST || step < 0.0)
        return say(u, FMI_ERROR, "time and step of a communication must be finite and below 9e9 s, and no step is negative");
    if (!on_grid(llround(now * 1e9) - at, h)) {
        snprintf(sentence, sizeof sentence, "the communication begins at %.9g s, and the unit is at %.9g s", now, 1e-9 * (double)at);
        return say(u, FMI_ERROR, sentence);
    }
    int64_t length = llround((now + step) * 1e9) - at, n = (length + h / 2) / h;
    if (!on_grid(length - n * h, h)) {
        snprintf(sentence, sizeof sentence,
                 "a communication step of %.9g ms is no multiple of the step of the model, %.9g ms: take %.9g or %.9g ms, or "
                 "write the unit with --set integrator.h=...; nothing was done",
                 1e-6 * (double)length, 1e-6 * (double)h, 1e-6 * (double)(length / h * h), 1e-6 * (double)((length / h + 1) * h));
        return say(u, FMI_ERROR, sentence); /* some importers ask again for ever after "discard" */
    }
    int code = mbd_step(m, n);
    return code == MBD_OK ? FMI_OK : answered(u, code);
}

static double time_of(const unit *u) { return 1e-9 * (double)(u->model->run->k * mbd_h_ns(u->model) + u->model->run->start); }

/* -- states -------------------------------------------------------------------------------------------------------- */

static status save_state(const unit *u, void **state) {
    size_t size = mbd_size(u->model);
    saved *s = *state;
    if (s == NULL && (s = malloc(sizeof *s + size)) == NULL) return say(u, FMI_ERROR, mbd_text(MBD_MEMORY));
    s->size = size;
    mbd_save(u->model, s->bytes, size);
    *state = s;
    return FMI_OK;
}

static status restore_state(unit *u, const void *state) {
    const saved *s = state;
    return s == NULL ? say(u, FMI_ERROR, "no state was given") : answered(u, mbd_restore(u->model, s->bytes, s->size));
}

static status copy_out(const unit *u, const void *state, unsigned char *to, size_t size) {
    const saved *s = state;
    if (s == NULL || to == NULL || size < s->size) return say(u, FMI_ERROR, "the room for a state is too small");
    memcpy(to, s->bytes, s->size);
    return FMI_OK;
}

/* A state from bytes, once it has been seen to be one of this model: it is restored, and the present one again. */
static status copy_in(unit *u, const unsigned char *from, size_t size, void **state) {
    void *present = NULL;
    *state = NULL;
    if (from == NULL || save_state(u, &present) != FMI_OK) return FMI_ERROR;
    int code = mbd_restore(u->model, from, size);
    saved *s = code == MBD_OK ? malloc(sizeof *s + size) : NULL;
    if (s != NULL) {
        s->size = size;
        memcpy(s->bytes, from, size);
        *state = s;
    } else if (code == MBD_OK) code = MBD_MEMORY;
    if (code == MBD_OK) restore_state(u, present);
    free(present);
    return answered(u, code);
}

/* -- FMI 2.0 ------------------------------------------------------------------------------------------------------- */

typedef int boolean2;

FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI const char *fmi2GetVersion(void) { return "2.0"; }

FMI void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const callbacks2 *functions,
                          boolean2 visible, boolean2 logging) {
    (void)visible;
    if (functions == NULL) return NULL;
    unit *u = new_unit(name, guid, resources, logging, functions->environment, functions->logger, NULL);
    return u != NULL && type != 1 ? refused(u, "this is a unit of co-simulation, not of model exchange") : u;
}

FMI void fmi2FreeInstance(void *u) { free_unit(u); }

FMI status fmi2SetDebugLogging(void *u, boolean2 on, size_t n, const char *const categories[]) {
    (void)n, (void)categories;
    ((unit *)u)->logging = on;
    return FMI_OK;
}

FMI status fmi2SetupExperiment(void *u, boolean2 given, double tolerance, double start, boolean2 ends, double stop) {
    (void)given, (void)tolerance, (void)ends, (void)stop;
    return begin_at(u, start);
}

FMI status fmi2EnterInitializationMode(void *u) { return to_mode(u, INITIALIZING, "to begin the initialization"); }
FMI status fmi2ExitInitializationMode(void *u) { return to_mode(u, STEPPING, "to end the initialization"); }
FMI status fmi2Terminate(void *u) { return terminate(u); }

FMI status fmi2Reset(void *u) { return answered(u, mbd_reset(((unit *)u)->model)); }

FMI status fmi2GetReal(void *u, const unsigned v[], size_t n, double values[]) { return get(u, v, n, values); }
FMI status fmi2SetReal(void *u, const unsigned v[], size_t n, const double values[]) { return set(u, v, n, values); }

static status no_other(void *u, size_t n) {
    return n == 0 ? FMI_OK : say(u, FMI_ERROR, "all variables of this unit are floats of 64 bits");
}

#define OTHER2(name, type)                                                                                 \
    FMI status fmi2Get##name(void *u, const unsigned v[], size_t n, type values[]) {                       \
        return (void)v, (void)values, no_other(u, n);                                                      \
    }                                                                                                      \
    FMI status fmi2Set##name(void *u, const unsigned v[], size_t n, const type values[]) {                 \
        return (void)v, (void)values, no_other(u, n);                                                      \
    }
OTHER2(Integer, int)
OTHER2(Boolean, boolean2)
typedef const char *string;
OTHER2(String, string)

FMI status fmi2GetFMUstate(void *u, void **state) { return save_state(u, state); }
FMI status fmi2SetFMUstate(void *u, void *state) { return restore_state(u, state); }

FMI status fmi2FreeFMUstate(void *u, void **state) {
    (void)u;
    free(*state);
    *state = NULL;
    return FMI_OK;
}

FMI status fmi2SerializedFMUstateSize(void *u, void *state, size_t *size) {
    if (state == NULL) return say(u, FMI_ERROR, "no state was given");
    *size = ((saved *)state)->size;
    return FMI_OK;
}

FMI status fmi2SerializeFMUstate(void *u, void *state, char to[], size_t size) { return copy_out(u, state, (unsigned char *)to, size); }

FMI status fmi2DeSerializeFMUstate(void *u, const char from[], size_t size, void **state) {
    return copy_in(u, (const unsigned char *)from, size, state);
}

FMI status fmi2DoStep(void *u, double now, double step, boolean2 no_going_back) {
    (void)no_going_back;
    return step_by(u, now, step);
}

static status not_here(void *u, const char *what) {
    char sentence[120];
    snprintf(sentence, sizeof sentence, "%s is not possible with this unit", what);
    return say(u, FMI_ERROR, sentence);
}

FMI status fmi2GetDirectionalDerivative(void *u, const unsigned unknown[], size_t n, const unsigned of[], size_t m,
                                        const double along[], double values[]) {
    return (void)unknown, (void)n, (void)of, (void)m, (void)along, (void)values, not_here(u, "a directional derivative");
}
FMI status fmi2SetRealInputDerivatives(void *u, const unsigned v[], size_t n, const int order[], const double values[]) {
    return (void)v, (void)order, (void)values, n == 0 ? FMI_OK : not_here(u, "a derivative of an input");
}
FMI status fmi2GetRealOutputDerivatives(void *u, const unsigned v[], size_t n, const int order[], double values[]) {
    return (void)v, (void)order, (void)values, n == 0 ? FMI_OK : not_here(u, "a derivative of an output");
}
FMI status fmi2CancelStep(void *u) { return not_here(u, "to cancel a step, which is done when it returns,"); }
FMI status fmi2GetStatus(void *u, int kind, status *value) { return (void)u, (void)kind, *value = FMI_OK, FMI_OK; }
FMI status fmi2GetRealStatus(void *u, int kind, double *value) {
    *value = time_of(u); /* kind 2: the last time that was reached */
    return kind == 2 ? FMI_OK : FMI_DISCARD;
}
FMI status fmi2GetIntegerStatus(void *u, int kind, int *value) { return (void)u, (void)kind, *value = 0, FMI_DISCARD; }
FMI status fmi2GetBooleanStatus(void *u, int kind, boolean2 *value) {
    *value = 0; /* kind 3: whether it wants to end */
    return (void)u, kind == 3 ? FMI_OK : FMI_DISCARD;
}
FMI status fmi2GetStringStatus(void *u, int kind, const char **value) { return (void)u, (void)kind, *value = "", FMI_DISCARD; }

/* -- FMI 3.0 ------------------------------------------------------------------------------------------------------- */

FMI const char *fmi3GetVersion(void) { return "3.0"; }

FMI status fmi3SetDebugLogging(void *u, bool on, size_t n, const char *const categories[]) {
    return fmi2SetDebugLogging(u, on, n, categories);
}

FMI void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible, bool logging,
                                      bool events, bool early, const unsigned needed[], size_t n, void *environment,
                                      logger3 logger, void *intermediate) {
    (void)visible, (void)events, (void)early, (void)needed, (void)n, (void)intermediate;
    return new_unit(name, token, resources, logging, environment, NULL, logger);
}
FMI void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, bool visible, bool logging,
                                       void *environment, logger3 logger) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    if (logger != NULL) logger(environment, FMI_ERROR, "errors", "this is a unit of co-simulation, not of model exchange");
    return NULL;
}
FMI void *fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *resources, bool visible, bool logging,
                                            void *environment, logger3 logger, void *update, void *lock, void *unlock) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)update, (void)lock, (void)unlock;
    if (logger != NULL) logger(environment, FMI_ERROR, "errors", "this is a unit of co-simulation, not of scheduled execution");
    return NULL;
}
FMI void fmi3FreeInstance(void *u) { free_unit(u); }

FMI status fmi3EnterInitializationMode(void *u, bool given, double tolerance, double start, bool ends, double stop) {
    (void)given, (void)tolerance, (void)ends, (void)stop;
    return begin_at(u, start) == FMI_OK ? to_mode(u, INITIALIZING, "to begin the initialization") : FMI_ERROR;
}
FMI status fmi3ExitInitializationMode(void *u) { return to_mode(u, STEPPING, "to end the initialization"); }
FMI status fmi3EnterStepMode(void *u) { return (void)u, FMI_OK; }
FMI status fmi3EnterEventMode(void *u) { return not_here(u, "event mode"); }
FMI status fmi3EnterConfigurationMode(void *u) { return (void)u, FMI_OK; }
FMI status fmi3ExitConfigurationMode(void *u) { return (void)u, FMI_OK; }
FMI status fmi3Terminate(void *u) { return terminate(u); }
FMI status fmi3Reset(void *u) { return answered(u, mbd_reset(((unit *)u)->model)); }

static status counted(void *u, size_t n, size_t values) {
    return n == values ? FMI_OK : say(u, FMI_ERROR, "as many values as value references are needed: all variables are scalars");
}
FMI status fmi3GetFloat64(void *u, const unsigned v[], size_t n, double values[], size_t m) {
    return counted(u, n, m) == FMI_OK ? get(u, v, n, values) : FMI_ERROR;
}
FMI status fmi3SetFloat64(void *u, const unsigned v[], size_t n, const double values[], size_t m) {
    return counted(u, n, m) == FMI_OK ? set(u, v, n, values) : FMI_ERROR;
}

#define OTHER3(name, type)                                                                                 \
    FMI status fmi3Get##name(void *u, const unsigned v[], size_t n, type values[], size_t m) {             \
        return (void)v, (void)values, (void)m, no_other(u, n);                                             \
    }                                                                                                      \
    FMI status fmi3Set##name(void *u, const unsigned v[], size_t n, const type values[], size_t m) {       \
        return (void)v, (void)values, (void)m, no_other(u, n);                                             \
    }
OTHER3(Float32, float)
OTHER3(Int8, int8_t)
OTHER3(UInt8, uint8_t)
OTHER3(Int16, int16_t)
OTHER3(UInt16, uint16_t)
OTHER3(Int32, int32_t)
OTHER3(UInt32, uint32_t)
OTHER3(Int64, int64_t)
OTHER3(UInt64, uint64_t)
OTHER3(Boolean, bool)
OTHER3(String, string)
FMI status fmi3GetBinary(void *u, const unsigned v[], size_t n, size_t sizes[], const uint8_t *values[], size_t m) {
    return (void)v, (void)sizes, (void)values, (void)m, no_other(u, n);
}
FMI status fmi3SetBinary(void *u, const unsigned v[], size_t n, const size_t sizes[], const uint8_t *const values[], size_t m) {
    return (void)v, (void)sizes, (void)values, (void)m, no_other(u, n);
}
FMI status fmi3GetClock(void *u, const unsigned v[], size_t n, bool values[]) { return (void)v, (void)values, no_other(u, n); }
FMI status fmi3SetClock(void *u, const unsigned v[], size_t n, const bool values[]) { return (void)v, (void)values, no_other(u, n); }

FMI status fmi3GetNumberOfVariableDependencies(void *u, unsigned v, size_t *n) {
    return (void)v, *n = 0, not_here(u, "to ask for dependencies");
}
FMI status fmi3GetVariableDependencies(void *u, unsigned v, size_t a[], unsigned b[], size_t c[], int d[], size_t n) {
    return (void)v, (void)a, (void)b, (void)c, (void)d, (void)n, not_here(u, "to ask for dependencies");
}
FMI status fmi3GetFMUState(void *u, void **state) { return save_state(u, state); }
FMI status fmi3SetFMUState(void *u, void *state) { return restore_state(u, state); }
FMI status fmi3FreeFMUState(void *u, void **state) { return fmi2FreeFMUstate(u, state); }
FMI status fmi3SerializedFMUStateSize(void *u, void *state, size_t *size) { return fmi2SerializedFMUstateSize(u, state, size); }
FMI status fmi3SerializeFMUState(void *u, void *state, uint8_t to[], size_t size) { return copy_out(u, state, to, size); }
FMI status fmi3DeserializeFMUState(void *u, const uint8_t from[], size_t size, void **state) { return copy_in(u, from, size, state); }
FMI status fmi3GetDirectionalDerivative(void *u, const unsigned a[], size_t n, const unsigned b[], size_t m, const double c[],
                                        size_t k, double d[], size_t l) {
    return (void)a, (void)n, (void)b, (void)m, (void)c, (void)k, (void)d, (void)l, not_here(u, "a directional derivative");
}
FMI status fmi3GetAdjointDerivative(void *u, const unsigned a[], size_t n, const unsigned b[], size_t m, const double c[], size_t k,
                                    double d[], size_t l) {
    return (void)a, (void)n, (void)b, (void)m, (void)c, (void)k, (void)d, (void)l, not_here(u, "an adjoint derivative");
}
FMI status fmi3GetOutputDerivatives(void *u, const unsigned v[], size_t n, const int32_t order[], double values[], size_t m) {
    return (void)v, (void)order, (void)values, (void)m, n == 0 ? FMI_OK : not_here(u, "a derivative of an output");
}

FMI status fmi3DoStep(void *u, double now, double step, bool no_going_back, bool *event, bool *end, bool *early, double *reached) {
    (void)no_going_back;
    status s = step_by(u, now, step);
    *event = *end = *early = false;
    *reached = time_of(u);
    return s;
}

/* Functions of clocks, model exchange and scheduled execution, which importers look for and a unit of co-simulation
 * without clocks is never asked for. */
#define NEVER3(name) \
    FMI status fmi3##name(void *u) { return not_here(u, #name); }
NEVER3(GetIntervalDecimal)
NEVER3(GetIntervalFraction)
NEVER3(GetShiftDecimal)
NEVER3(GetShiftFraction)
NEVER3(SetIntervalDecimal)
NEVER3(SetIntervalFraction)
NEVER3(SetShiftDecimal)
NEVER3(SetShiftFraction)
NEVER3(EvaluateDiscreteStates)
NEVER3(UpdateDiscreteStates)
NEVER3(EnterContinuousTimeMode)
NEVER3(CompletedIntegratorStep)
NEVER3(SetTime)
NEVER3(SetContinuousStates)
NEVER3(GetContinuousStateDerivatives)
NEVER3(GetEventIndicators)
NEVER3(GetContinuousStates)
NEVER3(GetNominalsOfContinuousStates)
NEVER3(GetNumberOfEventIndicators)
NEVER3(GetNumberOfContinuousStates)
NEVER3(ActivateModelPartition)
