/* controller.c: a speed controller by the functions of FMI 2.0, for test_controllers.py. It crashes, fails or writes to
 * the standard output at a time that a parameter says. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef void (*logger)(void *environment, const char *name, int status, const char *category, const char *message, ...);
typedef struct {
    logger log;
    void *allocate, *free, *finished, *environment;
} callbacks;

enum { SPEED, TORQUE, GAIN, TARGET, CRASH, FAIL, INTEGRAL, NUMBERS };
typedef struct {
    double number[NUMBERS];
    const callbacks *functions;
} unit;

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const callbacks *functions, int visible,
                      int logging) {
    (void)name, (void)type, (void)guid, (void)resources, (void)visible, (void)logging;
    unit *u = calloc(1, sizeof *u);
    u->functions = functions;
    u->number[GAIN] = 100.0, u->number[TARGET] = 25.0;
    puts("a unit may print what it likes");
    return u;
}
void fmi2FreeInstance(void *u) { free(u); }
int fmi2SetDebugLogging(void *u, int on, size_t n, const char *const c[]) { return (void)u, (void)on, (void)n, (void)c, 0; }
int fmi2SetupExperiment(void *u, int a, double b, double c, int d, double e) {
    return (void)u, (void)a, (void)b, (void)c, (void)d, (void)e, 0;
}
int fmi2EnterInitializationMode(void *u) { return (void)u, 0; }
int fmi2ExitInitializationMode(void *u) { return (void)u, 0; }
int fmi2Terminate(void *u) { return (void)u, 0; }
int fmi2Reset(void *u) { return (void)u, 0; }

int fmi2GetReal(void *u, const unsigned v[], size_t n, double values[]) {
    for (size_t k = 0; k < n; k++) values[k] = ((unit *)u)->number[v[k]];
    return 0;
}
int fmi2SetReal(void *u, const unsigned v[], size_t n, const double values[]) {
    for (size_t k = 0; k < n; k++) ((unit *)u)->number[v[k]] = values[k];
    return 0;
}

int fmi2DoStep(void *instance, double now, double step, int no_going_back) {
    unit *u = instance;
    double *x = u->number, off = x[TARGET] - x[SPEED];
    (void)no_going_back;
    if (x[CRASH] > 0.0 && now >= x[CRASH]) abort();
    if (x[FAIL] > 0.0 && now >= x[FAIL]) {
        u->functions->log(u->functions->environment, "one", 3, "error", "the valve is stuck");
        return 3;
    }
    x[INTEGRAL] += off * step;
    x[TORQUE] = x[GAIN] * off + x[INTEGRAL];
    return 0;
}

int fmi2GetFMUstate(void *u, void **state) {
    if (*state == NULL) *state = malloc(sizeof(((unit *)u)->number));
    memcpy(*state, ((unit *)u)->number, sizeof(((unit *)u)->number));
    return 0;
}
int fmi2SetFMUstate(void *u, void *state) { return memcpy(((unit *)u)->number, state, NUMBERS * sizeof(double)), 0; }
int fmi2FreeFMUstate(void *u, void **state) { return (void)u, free(*state), *state = NULL, 0; }
int fmi2SerializedFMUstateSize(void *u, void *state, size_t *size) {
    return (void)u, (void)state, *size = NUMBERS * sizeof(double), 0;
}
int fmi2SerializeFMUstate(void *u, void *state, char to[], size_t size) { return (void)u, memcpy(to, state, size), 0; }
int fmi2DeSerializeFMUstate(void *u, const char from[], size_t size, void **state) {
    (void)u;
    *state = malloc(size);
    return memcpy(*state, from, size), 0;
}

/* Functions that importers look for and this unit is never asked for. */
#define NEVER(name) \
    int fmi2##name(void) { return 3; }
NEVER(GetInteger)
NEVER(SetInteger)
NEVER(GetBoolean)
NEVER(SetBoolean)
NEVER(GetString)
NEVER(SetString)
NEVER(GetDirectionalDerivative)
NEVER(SetRealInputDerivatives)
NEVER(GetRealOutputDerivatives)
NEVER(CancelStep)
NEVER(GetStatus)
NEVER(GetRealStatus)
NEVER(GetIntegerStatus)
NEVER(GetBooleanStatus)
NEVER(GetStringStatus)
