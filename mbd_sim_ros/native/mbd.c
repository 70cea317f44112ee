/* mbd.c: loads models and drives the compiled kernels; see mbd.h. The layout of a model is that of model.py. */
#include "mbd.h"

#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "kernels.inc" /* written by library.py: MBD_KERNELS(X), MBD_TARGET, MBD_AVX512 */
#include "sha256.inc"

/* Header of a model: magic, digest of all that follows, and fields. The order is that of FIELDS in model.py. */
enum { MAGIC = 16, DIGEST = 32 };
static const char magic[MAGIC] = "mbd model 2\n";
static const char state_magic[MAGIC] = "mbd state 1\n";

enum field {
    SIZE, H_NS, DURATION, ADAPTS, ENTRY, CHASSIS,
    CONSTANT_AT, CONSTANT_SIZE, WRITTEN_AT, WRITTEN_SIZE, FIXUPS_AT, FIXUPS, KERNELS_AT, KERNELS,
    VARIABLES_AT, VARIABLES, TEXTS_AT, TEXTS_SIZE, MANEUVER_AT, RUNS, SETTLED, INPUTS, MOTIONS_AT, MOTIONS,
    TABLES, SCHEME, CONTROL, STATE_A, STATE_B, WORK, ROW, RUN, SOURCE, FILTER, NUMBERS, NUMBERS_COUNT,
    COUNTS, EVENTS, PROGRESS, LIMITS_AT, PLACES_AT, PLACES, WALLS_AT, WALLS, WATCH_AT, WATCH_SIZE,
    MEMORY_AT, MEMORY, SCENE, PROGRAM, UNCHECKED, FIELDS
};

enum { SECTION_CONSTANT, SECTION_WRITTEN, SECTION_KERNEL };
enum { SUBSTEPS, REJECTED, PENDING };       /* solver/step/control.py: entries of counts */
enum { OPEN = 0 };                          /* and of progress */
enum { EVENT_WIDTH = 6, OF_STEP = 0, OF_PENALTY = 1 };
enum { OK, NOT_CONVERGED, NON_FINITE, SINGULAR, INACCURATE, BAD_INPUT, PAUSED }; /* solver/step/work.py */

typedef struct { int64_t section, offset, target, at; } fixup;
typedef struct { int64_t name, unit, kind, offset; } variable; /* texts; offset in what is written */
typedef struct { int64_t value, rate, acceleration, filtered, state; } motion; /* indices of inputs; state: a double */
typedef struct { int64_t iterations, factorizations, evaluations, stagnated; double residual, position, velocity; } counters;
typedef struct { int64_t status, where; counters c; int64_t done; uint8_t swapped; } result;

/* What a run remembers besides state and account; part of what is written (RUN in model.py). start: [ns], and mode: for
 * units. followed: 1 where an input has followed the maneuver. */
typedef struct { int64_t k, swapped, audit, events, rescued; counters total; double smallest; int64_t start, mode, followed; } run;

typedef int32_t (*adapting)(result *, void **, int64_t, int64_t, int64_t, int64_t, int64_t, void *, void *, int64_t, int64_t,
                            double *, int64_t, int64_t, int64_t, int64_t, int64_t, int64_t, int64_t, uint8_t, int64_t);
typedef int32_t (*constant)(result *, void **, int64_t, int64_t, int64_t, int64_t, void *, void *, int64_t, int64_t, double *,
                            int64_t, int64_t, int64_t, int64_t, int64_t, int64_t, uint8_t, int64_t);

/* What models with the same tables share: the content as it was loaded, and tables with addresses. */
typedef struct {
    atomic_int users;
    char *content;
    const int64_t *field;
    char *tables;
    void **kernels;
} shared;

struct mbd_model {
    shared *common;
    char *written;
    run *run;
    double *row;
    int64_t *source; /* of every input: 0 it follows the maneuver, 1 it holds what was set, 2 a command passes the filter */
    mbd_logger logger;
    void *user;
    char message[800];
};

static const struct { const char *name; void *code; } known[] = {
#define X(name, symbol) {name, (void *)symbol},
    MBD_KERNELS(X)
#undef X
};

static const char *const texts[] = {
    "no error",
    "the file cannot be read: check its path and permissions",
    "not a model or state of mbd, or damaged: write it anew with `mbd build`",
    "written by another version of mbd: write model and library with the same one",
    "the library lacks kernels of this model: write both with one `mbd build`",
    "the library needs instructions that this processor lacks: build it for this one with `mbd build --target host`",
    "no memory is left",
    "an argument is wrong",
    "the state is that of another model",
    "the maneuver of the scene has ended: set the inputs that follow it",
    "an input is not finite",
    "a step did not converge: reduce integrator.h",
    "the motion is no longer finite: reduce integrator.h or check loads",
    "the matrix of a step is singular: give every body mass and inertia, or constrain it",
    "the error stays above integrator.error_tolerance: allow more",
    "an error of the program",
};

const char *mbd_text(int code) {
    return code >= 0 && (size_t)code < sizeof texts / sizeof *texts ? texts[code] : "no such code";
}

static const int64_t *fields(const mbd_model *m) { return m->common->field; }
static const char *part(const mbd_model *m, enum field at) { return m->common->content + fields(m)[at]; }
static char *in_written(const mbd_model *m, int64_t offset) { return m->written + offset; }
static const char *text(const mbd_model *m, int64_t at) { return part(m, TEXTS_AT) + at; }
static const variable *variables(const mbd_model *m) { return (const variable *)part(m, VARIABLES_AT); }
static const motion *motions(const mbd_model *m) { return (const motion *)part(m, MOTIONS_AT); }

static int fail(mbd_model *m, int code, const char *sentence) {
    snprintf(m->message, sizeof m->message, "%s", sentence);
    return code;
}

/* -- loading ------------------------------------------------------------------------------------------------------- */

static int runs_here(void) {
    __builtin_cpu_init();
    if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma") || !__builtin_cpu_supports("bmi2")) return 0;
#if MBD_AVX512
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd");
#else
    return 1;
#endif
}

static int lies_within(int64_t at, int64_t count, int64_t size, int64_t end) {
    return at >= 0 && count >= 0 && at % 8 == 0 && at <= end && count <= (end - at) / size;
}

static int judged_consistent(const char *content, const int64_t *f);
static int watch_consistent(const char *content, const int64_t *f);
static size_t judged_size(void), watch_size(void);

/* Whether every place that the header and the lists of the content name lies within it, so that loading reads and writes
 * nothing beside it. What stands in the tables and in a state (indices, numbers of entries) is not looked at: where the
 * digest fits, it is what `mbd build` or mbd_save() wrote. The digest is no signature: whoever writes a file can write
 * one that fits. */
static int consistent(const char *content, int64_t size) {
    const int64_t *f = (const int64_t *)(content + MAGIC + DIGEST);
    const int64_t end = size, written = f[WRITTEN_SIZE], tables = f[CONSTANT_SIZE];
    if (f[SIZE] != size || f[H_NS] <= 0 || f[INPUTS] < 0 || f[DURATION] < 0) return 0;
    if (!lies_within(f[CONSTANT_AT], tables, 1, end) || !lies_within(f[WRITTEN_AT], written, 1, end)) return 0;
    if (!lies_within(f[FIXUPS_AT], f[FIXUPS], sizeof(fixup), end) || !lies_within(f[KERNELS_AT], f[KERNELS], 8, end)) return 0;
    if (!lies_within(f[VARIABLES_AT], f[VARIABLES], sizeof(variable), end)) return 0;
    if (!lies_within(f[MOTIONS_AT], f[MOTIONS], sizeof(motion), end) || !lies_within(f[LIMITS_AT], (int64_t)judged_size(), 1, end)) return 0;
    if (!lies_within(f[PLACES_AT], f[PLACES], 8, end) || !lies_within(f[WALLS_AT], f[WALLS], 8, end)) return 0;
    if (!lies_within(f[WATCH_AT], f[WATCH_SIZE], 1, end) || f[WATCH_SIZE] < (int64_t)watch_size()) return 0;
    if (!lies_within(f[MEMORY_AT], f[MEMORY], 8, written)) return 0;
    if (!lies_within(f[TEXTS_AT], f[TEXTS_SIZE], 1, end) || f[TEXTS_SIZE] < 1) return 0;
    if (content[f[TEXTS_AT] + f[TEXTS_SIZE] - 1] != 0 || f[ENTRY] < 0 || f[ENTRY] >= f[KERNELS]) return 0;
    if (f[INPUTS] > 1 << 20 || !lies_within(f[MANEUVER_AT], f[RUNS], 8 * (1 + f[INPUTS]), end)) return 0;
    if (!lies_within(f[ROW], f[INPUTS], 8, written) || !lies_within(f[SOURCE], f[INPUTS], 8, written)) return 0;
    if (!lies_within(f[RUN], sizeof(run), 1, written) || !lies_within(f[FILTER], 2, 8, written)) return 0;
    if (!lies_within(f[NUMBERS], f[NUMBERS_COUNT], 8, written) || !lies_within(f[COUNTS], 3, 8, written)) return 0;
    if (!lies_within(f[EVENTS], EVENT_WIDTH, 8, written) || !lies_within(f[PROGRESS], 1, 8, written)) return 0;
    if (!lies_within(f[TABLES], 1, 8, tables)) return 0;
    for (int k = SCHEME; k <= WORK; k++)
        if (!lies_within(f[k], 1, 8, written)) return 0;
    const int64_t ends[] = {tables, written, f[KERNELS]};
    const fixup *x = (const fixup *)(content + f[FIXUPS_AT]);
    for (int64_t k = 0; k < f[FIXUPS]; k++) {
        if (x[k].section < 0 || x[k].section > SECTION_WRITTEN || x[k].target < 0 || x[k].target > SECTION_KERNEL) return 0;
        if (!lies_within(x[k].offset, 1, 8, ends[x[k].section])) return 0;
        if (x[k].at < 0 || x[k].at >= ends[x[k].target]) return 0;
        if (x[k].section == SECTION_CONSTANT && x[k].target == SECTION_WRITTEN) return 0;
    }
    const variable *v = (const variable *)(content + f[VARIABLES_AT]);
    for (int64_t k = 0; k < f[VARIABLES]; k++)
        if (v[k].name < 0 || v[k].name >= f[TEXTS_SIZE] || v[k].unit < 0 || v[k].unit >= f[TEXTS_SIZE] || v[k].kind < 0 ||
            v[k].kind > MBD_COUNTER || !lies_within(v[k].offset, 1, 8, written))
            return 0;
    const motion *moved = (const motion *)(content + f[MOTIONS_AT]);
    for (int64_t k = 0; k < f[MOTIONS]; k++)
        for (int i = 0; i < 3; i++)
            if ((&moved[k].value)[i] < 0 || (&moved[k].value)[i] >= f[INPUTS] || !lies_within(moved[k].state, 3, 8, written))
                return 0;
    const int64_t *names = (const int64_t *)(content + f[KERNELS_AT]);
    for (int64_t k = 0; k < f[KERNELS]; k++)
        if (names[k] < 0 || names[k] >= f[TEXTS_SIZE]) return 0;
    for (int k = SCENE; k <= UNCHECKED; k++)
        if (f[k] < 0 || f[k] >= f[TEXTS_SIZE]) return 0;
    return judged_consistent(content, f) && watch_consistent(content, f);
}

static void fix(const shared *s, int section, char *memory, char *written) {
    const fixup *x = (const fixup *)(s->content + s->field[FIXUPS_AT]);
    for (int64_t k = 0; k < s->field[FIXUPS]; k++) {
        if (x[k].section != section) continue;
        void *to = x[k].target == SECTION_KERNEL ? s->kernels[x[k].at]
                 : (void *)((x[k].target == SECTION_CONSTANT ? s->tables : written) + x[k].at);
        memcpy(memory + x[k].offset, &to, sizeof to);
    }
}

static char *aligned(int64_t size) { return aligned_alloc(64, ((size_t)size + 127) / 64 * 64); }

static void release(shared *s) {
    if (s == NULL || atomic_fetch_sub(&s->users, 1) > 1) return;
    free(s->content);
    free(s->tables);
    free(s->kernels);
    free(s);
}

static int make_model(shared *s, mbd_model **model) {
    mbd_model *m = calloc(1, sizeof *m);
    if (m != NULL) m->written = aligned(s->field[WRITTEN_SIZE]);
    if (m == NULL || m->written == NULL) {
        free(m);
        return MBD_MEMORY;
    }
    m->common = s;
    m->run = (run *)(m->written + s->field[RUN]);
    m->row = (double *)(m->written + s->field[ROW]);
    m->source = (int64_t *)(m->written + s->field[SOURCE]);
    mbd_reset(m);
    *model = m;
    return MBD_OK;
}

static int find_kernels(shared *s) {
    const int64_t *names = (const int64_t *)(s->content + s->field[KERNELS_AT]);
    for (int64_t k = 0; k < s->field[KERNELS]; k++) {
        const char *name = s->content + s->field[TEXTS_AT] + names[k];
        for (size_t i = 0; i < sizeof known / sizeof *known && s->kernels[k] == NULL; i++)
            if (strcmp(known[i].name, name) == 0) s->kernels[k] = known[i].code;
        if (s->kernels[k] == NULL) return MBD_KERNELS;
    }
    return MBD_OK;
}

int mbd_make(const void *content, size_t size, mbd_model **model) {
    *model = NULL;
    if (!runs_here()) return MBD_PROCESSOR;
    if (content == NULL || size < MAGIC + DIGEST + 8 * FIELDS || size > INT64_MAX / 2) return MBD_DAMAGED;
    if (memcmp(content, magic, MAGIC) != 0) return memcmp(content, magic, 10) == 0 ? MBD_VERSION : MBD_DAMAGED;
    unsigned char digest[DIGEST];
    sha256((const unsigned char *)content + MAGIC + DIGEST, size - MAGIC - DIGEST, digest);
    if (memcmp(digest, (const char *)content + MAGIC, DIGEST) != 0) return MBD_DAMAGED;
    shared *s = calloc(1, sizeof *s);
    if (s == NULL) return MBD_MEMORY;
    atomic_init(&s->users, 1);
    int code = MBD_MEMORY;
    if ((s->content = aligned((int64_t)size)) != NULL) {
        memcpy(s->content, content, size);
        s->field = (const int64_t *)(s->content + MAGIC + DIGEST);
        code = consistent(s->content, (int64_t)size) ? MBD_OK : MBD_DAMAGED;
    }
    if (code == MBD_OK) {
        s->tables = aligned(s->field[CONSTANT_SIZE]);
        s->kernels = calloc((size_t)s->field[KERNELS] + 1, sizeof *s->kernels);
        code = s->tables == NULL || s->kernels == NULL ? MBD_MEMORY : find_kernels(s);
    }
    if (code == MBD_OK) {
        memcpy(s->tables, s->content + s->field[CONSTANT_AT], (size_t)s->field[CONSTANT_SIZE]);
        fix(s, SECTION_CONSTANT, s->tables, NULL);
        code = make_model(s, model);
    }
    if (code != MBD_OK) release(s);
    return code;
}

int mbd_open(const char *path, mbd_model **model) {
    *model = NULL;
    FILE *file = path == NULL ? NULL : fopen(path, "rb");
    if (file == NULL) return MBD_FILE;
    int code = MBD_FILE;
    long size = fseek(file, 0, SEEK_END) == 0 ? ftell(file) : -1;
    char *content = size >= 0 && fseek(file, 0, SEEK_SET) == 0 ? malloc((size_t)size + 1) : NULL;
    if (content != NULL && fread(content, 1, (size_t)size, file) == (size_t)size) code = mbd_make(content, (size_t)size, model);
    free(content);
    fclose(file);
    return code;
}

int mbd_copy(const mbd_model *model, mbd_model **copy) {
    *copy = NULL;
    int code = make_model(model->common, copy);
    if (code != MBD_OK) return code;
    atomic_fetch_add(&model->common->users, 1);
    memcpy((*copy)->written, model->written, (size_t)fields(model)[WRITTEN_SIZE]);
    fix(model->common, SECTION_WRITTEN, (*copy)->written, (*copy)->written);
    return MBD_OK;
}

void mbd_free(mbd_model *m) {
    if (m == NULL) return;
    release(m->common);
    free(m->written);
    free(m);
}

/* -- variables ----------------------------------------------------------------------------------------------------- */

const char *mbd_message(const mbd_model *m) { return m->message; }
const char *mbd_scene(const mbd_model *m) { return text(m, fields(m)[SCENE]); }
const char *mbd_version(const mbd_model *m) { return text(m, fields(m)[PROGRAM]); }
const char *mbd_unchecked(const mbd_model *m) { return text(m, fields(m)[UNCHECKED]); }
int mbd_variables(const mbd_model *m) { return (int)fields(m)[VARIABLES]; }

static int is_variable(const mbd_model *m, int v) { return v >= 0 && v < mbd_variables(m); }

int mbd_find(const mbd_model *m, const char *name) {
    for (int v = 0; name != NULL && v < mbd_variables(m); v++)
        if (strcmp(text(m, variables(m)[v].name), name) == 0) return v;
    return -1;
}

const char *mbd_name(const mbd_model *m, int v) { return is_variable(m, v) ? text(m, variables(m)[v].name) : ""; }
const char *mbd_unit(const mbd_model *m, int v) { return is_variable(m, v) ? text(m, variables(m)[v].unit) : ""; }
int mbd_kind(const mbd_model *m, int v) { return is_variable(m, v) ? (int)variables(m)[v].kind : -1; }

int mbd_get(const mbd_model *m, int v, double *value) {
    if (!is_variable(m, v)) return MBD_ARGUMENT;
    memcpy(value, in_written(m, variables(m)[v].offset), sizeof *value);
    if (variables(m)[v].kind == MBD_COUNTER) { /* a whole number */
        int64_t whole;
        memcpy(&whole, in_written(m, variables(m)[v].offset), sizeof whole);
        *value = (double)whole;
    }
    return MBD_OK;
}

const double *mbd_numbers(const mbd_model *m, size_t *count) {
    if (count != NULL) *count = (size_t)fields(m)[NUMBERS_COUNT];
    return (const double *)in_written(m, fields(m)[NUMBERS]);
}

/* -- inputs -------------------------------------------------------------------------------------------------------- */

enum { FOLLOWS, HOLDS, FILTERED };

/* The input of a variable, or -1 with a message; *moved is the motion that it is a part of, or NULL. */
static int64_t input_of(mbd_model *m, int v, const motion **moved) {
    *moved = NULL;
    if (!is_variable(m, v) || variables(m)[v].kind != MBD_INPUT_KIND) {
        snprintf(m->message, sizeof m->message, "%s is not an input", is_variable(m, v) ? mbd_name(m, v) : "no variable");
        return -1;
    }
    int64_t input = (variables(m)[v].offset - fields(m)[ROW]) / 8;
    for (int64_t k = 0; k < fields(m)[MOTIONS]; k++)
        for (int i = 0; i < 3; i++)
            if ((&motions(m)[k].value)[i] == input) *moved = &motions(m)[k];
    return input;
}

int mbd_set(mbd_model *m, int v, double value) {
    const motion *moved;
    int64_t input = input_of(m, v, &moved);
    if (input < 0) return MBD_ARGUMENT;
    if (!isfinite(value)) {
        snprintf(m->message, sizeof m->message, "input %s is not finite: it stays as it was", mbd_name(m, v));
        return MBD_INPUT;
    }
    if (moved == NULL) {
        m->row[input] = value;
        m->source[input] = HOLDS;
        return MBD_OK;
    }
    if (!moved->filtered || moved->value != input) {
        snprintf(m->message, sizeof m->message, "%s is part of a prescribed motion: set it with mbd_set_motion()", mbd_name(m, v));
        return MBD_ARGUMENT;
    }
    double *state = (double *)in_written(m, moved->state); /* command, reference, (angle and rate are those of the row) */
    if (m->source[input] != FILTERED) state[1] = m->row[moved->value];
    state[0] = value;
    m->source[moved->value] = m->source[moved->rate] = m->source[moved->acceleration] = FILTERED;
    return MBD_OK;
}

int mbd_set_motion(mbd_model *m, int v, double value, double rate, double acceleration) {
    const motion *moved;
    int64_t input = input_of(m, v, &moved);
    if (input < 0) return MBD_ARGUMENT;
    if (moved == NULL || moved->value != input) {
        snprintf(m->message, sizeof m->message, "%s is not a prescribed motion: set it with mbd_set()", mbd_name(m, v));
        return MBD_ARGUMENT;
    }
    if (!isfinite(value) || !isfinite(rate) || !isfinite(acceleration)) {
        snprintf(m->message, sizeof m->message, "motion %s is not finite: it stays as it was", mbd_name(m, v));
        return MBD_INPUT;
    }
    m->row[moved->value] = value, m->row[moved->rate] = rate, m->row[moved->acceleration] = acceleration;
    m->source[moved->value] = m->source[moved->rate] = m->source[moved->acceleration] = HOLDS;
    return MBD_OK;
}

int mbd_follow(mbd_model *m, int v) {
    const motion *moved;
    int64_t input = input_of(m, v, &moved);
    if (input < 0) return MBD_ARGUMENT;
    m->source[input] = FOLLOWS;
    if (moved != NULL) m->source[moved->value] = m->source[moved->rate] = m->source[moved->acceleration] = FOLLOWS;
    return MBD_OK;
}

int mbd_filter(mbd_model *m, double bandwidth, double limit) {
    double *filter = (double *)in_written(m, fields(m)[FILTER]);
    if (!(bandwidth > 0.0) || !(limit > 0.0) || !isfinite(bandwidth) || !isfinite(limit))
        return fail(m, MBD_ARGUMENT, "bandwidth and rate limit of the steering filter must be > 0");
    filter[0] = bandwidth, filter[1] = limit;
    return MBD_OK;
}

/* (x, x') after t seconds behind a reference that starts at r and moves at `slope`: follow() of
 * solver/inputs/command_filter.py, operation by operation. */
static void follow(double omega, double *x, double *v, double r, double slope, double t) {
    double lag = 2.0 * slope / omega;
    double e = *x - (r - lag), b = *v - slope + omega * e, decay = exp(-omega * t);
    *x = r - lag + slope * t + (e + b * t) * decay;
    *v = slope + (b - omega * (e + b * t)) * decay;
}

static void turn(mbd_model *m, const motion *moved) {
    const double *filter = (const double *)in_written(m, fields(m)[FILTER]);
    double *state = (double *)in_written(m, moved->state), h = (double)fields(m)[H_NS] * 1e-9;
    double omega = 2.0 * 3.141592653589793 * filter[0], limit = filter[1], r = state[1];
    double x = m->row[moved->value], v = m->row[moved->rate], gap = state[0] - r;
    double run = fabs(gap) / limit < h ? fabs(gap) / limit : h, slope = gap > 0.0 ? limit : -limit;
    follow(omega, &x, &v, r, slope, run);
    r = run < h ? state[0] : r + slope * h;
    follow(omega, &x, &v, r, 0.0, h - run);
    state[1] = r;
    m->row[moved->value] = x, m->row[moved->rate] = v;
    m->row[moved->acceleration] = omega * omega * (r - x) - 2.0 * omega * v;
}

/* Row of the maneuver for step k, or NULL behind its end. *same: steps for which it stays, that one included. */
static const double *maneuver(const mbd_model *m, int64_t k, int64_t *same) {
    const int64_t *f = fields(m), runs = f[RUNS], *first = (const int64_t *)part(m, MANEUVER_AT);
    const double *rows = (const double *)(first + runs);
    if (runs == 0 || (k >= f[DURATION] && !f[SETTLED])) return NULL;
    int64_t low = 0, high = runs;
    while (high - low > 1) {
        int64_t middle = (low + high) / 2;
        if (first[middle] <= k) low = middle;
        else high = middle;
    }
    *same = low + 1 < runs ? first[low + 1] - k : f[SETTLED] ? INT64_MAX : f[DURATION] - k;
    return rows + low * f[INPUTS];
}

/* Inputs of the next step, in m->row. *same: steps for which they stay. */
static int sample(mbd_model *m, int64_t *same) {
    int64_t n = fields(m)[INPUTS], following = 0;
    *same = INT64_MAX;
    for (int64_t i = 0; i < n; i++) following += m->source[i] == FOLLOWS;
    if (following > 0) {
        const double *row = maneuver(m, m->run->k, same);
        if (row == NULL) {
            for (int64_t i = 0; i < n; i++)
                if (m->source[i] == FOLLOWS) {
                    snprintf(m->message, sizeof m->message,
                             "the maneuver of the scene ends at %g s, and input %lld still follows it: set it",
                             (double)(fields(m)[DURATION] * fields(m)[H_NS]) * 1e-9, (long long)i);
                    break;
                }
            return MBD_ENDED;
        }
        for (int64_t i = 0; i < n; i++)
            if (m->source[i] == FOLLOWS) m->row[i] = row[i];
        m->run->followed = 1;
    }
    for (int64_t k = 0; k < fields(m)[MOTIONS]; k++)
        if (m->source[motions(m)[k].value] == FILTERED) {
            turn(m, &motions(m)[k]);
            *same = 1;
        }
    return MBD_OK;
}

/* -- steps --------------------------------------------------------------------------------------------------------- */

static double larger(double a, double b) { return b > a ? b : a; }

static void add(counters *total, const counters *c) {
    total->iterations += c->iterations, total->factorizations += c->factorizations;
    total->evaluations += c->evaluations, total->stagnated += c->stagnated;
    total->residual = larger(total->residual, c->residual);
    total->position = larger(total->position, c->position), total->velocity = larger(total->velocity, c->velocity);
}

static void drain(mbd_model *m) {
    int64_t *counts = (int64_t *)in_written(m, fields(m)[COUNTS]);
    const double *events = (const double *)in_written(m, fields(m)[EVENTS]);
    for (int64_t k = 0; k < counts[PENDING]; k++, events += EVENT_WIDTH) {
        int kind = (int)events[1];
        m->run->events++;
        if (kind == OF_STEP && events[4] < m->run->smallest) m->run->smallest = events[4];
        if (m->logger != NULL) {
            char sentence[200];
            snprintf(sentence, sizeof sentence, "t = %.6f s: %s %g -> %g", events[0],
                     kind == OF_STEP ? "step [s]" : kind == OF_PENALTY ? "penalty of a row" : "accepted error [1/s]", events[3],
                     events[4]);
            m->logger(m->user, sentence);
        }
    }
    counts[PENDING] = 0;
}

static int64_t address(const mbd_model *m, enum field at) { return (int64_t)(intptr_t)in_written(m, fields(m)[at]); }

/* One call of the compiled steps; r->done of `count` are done. */
static int32_t call(mbd_model *m, int64_t count, result *r) {
    const int64_t *f = fields(m);
    void *exception = NULL;
    int64_t old = address(m, m->run->swapped ? STATE_B : STATE_A), new = address(m, m->run->swapped ? STATE_A : STATE_B);
    int64_t n = f[INPUTS], tables = (int64_t)(intptr_t)(m->common->tables + f[TABLES]);
    uint8_t audit = m->run->audit != 0;
    if (!f[ADAPTS]) {
        int32_t bad = ((constant)m->common->kernels[f[ENTRY]])(
            r, &exception, tables, address(m, SCHEME), old, new, NULL, NULL, n, 8, m->row, 1, n, 8 * n, 8, 0, count, audit,
            address(m, WORK));
        r->swapped = r->done % 2 == 1;
        return bad;
    }
    return ((adapting)m->common->kernels[f[ENTRY]])(
        r, &exception, tables, address(m, SCHEME), address(m, CONTROL), old, new, NULL, NULL, n, 8, m->row, 1, n, 8 * n, 8, 0,
        count, m->run->k, audit, address(m, WORK));
}

static int failure(mbd_model *m, const result *r) {
    static const int codes[] = {MBD_OK, MBD_NOT_CONVERGED, MBD_NOT_FINITE, MBD_SINGULAR, MBD_INACCURATE, MBD_INPUT};
    int code = r->status > 0 && r->status <= BAD_INPUT ? codes[r->status] : MBD_INTERNAL;
    snprintf(m->message, sizeof m->message, "t = %.6f s, step %lld: %s (place %lld, residual %.2g)", mbd_time(m),
             (long long)m->run->k, mbd_text(code), (long long)r->where, r->c.residual);
    return code;
}

/* `count` steps with the inputs in m->row. */
static int advance(mbd_model *m, int64_t count) {
    while (count > 0) {
        result r;
        memset(&r, 0, sizeof r);
        if (call(m, count, &r) != 0) return fail(m, MBD_INTERNAL, mbd_text(MBD_INTERNAL));
        if (r.swapped) m->run->swapped = !m->run->swapped;
        m->run->k += r.done;
        count -= r.done;
        add(&m->run->total, &r.c);
        if (fields(m)[ADAPTS]) drain(m);
        if (r.status == PAUSED) {
            const double *progress = (const double *)in_written(m, fields(m)[PROGRESS]);
            if (progress[OPEN] == 0.0) m->run->rescued++; /* across steps that were divided nobody looks for branches */
        } else if (r.status != OK) return failure(m, &r);
    }
    return MBD_OK;
}

double mbd_h(const mbd_model *m) { return (double)fields(m)[H_NS] * 1e-9; }
int64_t mbd_h_ns(const mbd_model *m) { return fields(m)[H_NS]; }
int64_t mbd_steps(const mbd_model *m) { return m->run->k; }
double mbd_time(const mbd_model *m) { return (double)(m->run->k * fields(m)[H_NS]) * 1e-9; }
int64_t mbd_duration(const mbd_model *m) { return fields(m)[DURATION]; }
void mbd_audit(mbd_model *m, int on) { m->run->audit = on != 0; }

#include "watch.inc"

int mbd_step(mbd_model *m, int64_t n) {
    if (n < 0) return fail(m, MBD_ARGUMENT, "the number of steps is negative");
    while (n > 0) {
        int64_t same;
        int code = sample(m, &same);
        int64_t count = same < n ? same : n, look = until_look(m);
        if (look < count) count = look;
        if (code == MBD_OK) code = advance(m, count);
        if (code != MBD_OK) return code;
        if (is_looked_at(m)) look_at_snapshot(m);
        n -= count;
    }
    return MBD_OK;
}

void mbd_log(mbd_model *m, mbd_logger logger, void *user) {
    m->logger = logger;
    m->user = user;
}

/* -- state --------------------------------------------------------------------------------------------------------- */

int mbd_reset(mbd_model *m) {
    memcpy(m->written, part(m, WRITTEN_AT), (size_t)fields(m)[WRITTEN_SIZE]);
    fix(m->common, SECTION_WRITTEN, m->written, m->written);
    m->message[0] = 0;
    return MBD_OK;
}

/* A state: magic, digest of what follows, digest of the model, all that is written with addresses left out. */
size_t mbd_size(const mbd_model *m) { return MAGIC + 2 * DIGEST + (size_t)fields(m)[WRITTEN_SIZE]; }

int mbd_save(const mbd_model *m, void *buffer, size_t size) {
    char *to = buffer;
    size_t written = (size_t)fields(m)[WRITTEN_SIZE];
    if (buffer == NULL || size < mbd_size(m)) return MBD_ARGUMENT;
    memcpy(to, state_magic, MAGIC);
    memcpy(to + MAGIC + DIGEST, m->common->content + MAGIC, DIGEST);
    char *copy = to + MAGIC + 2 * DIGEST;
    memcpy(copy, m->written, written);
    const fixup *x = (const fixup *)part(m, FIXUPS_AT);
    for (int64_t k = 0; k < fields(m)[FIXUPS]; k++)
        if (x[k].section == SECTION_WRITTEN) memset(copy + x[k].offset, 0, 8);
    sha256((const unsigned char *)to + MAGIC + DIGEST, DIGEST + written, (unsigned char *)to + MAGIC);
    return MBD_OK;
}

int mbd_restore(mbd_model *m, const void *buffer, size_t size) {
    const char *from = buffer;
    unsigned char digest[DIGEST];
    if (buffer == NULL || size < MAGIC + 2 * DIGEST || memcmp(from, state_magic, MAGIC) != 0)
        return fail(m, MBD_DAMAGED, mbd_text(MBD_DAMAGED));
    sha256((const unsigned char *)from + MAGIC + DIGEST, size - MAGIC - DIGEST, digest);
    if (memcmp(digest, from + MAGIC, DIGEST) != 0) return fail(m, MBD_DAMAGED, "the state is damaged");
    if (size != mbd_size(m) || memcmp(from + MAGIC + DIGEST, m->common->content + MAGIC, DIGEST) != 0)
        return fail(m, MBD_OTHER_MODEL, mbd_text(MBD_OTHER_MODEL));
    memcpy(m->written, from + MAGIC + 2 * DIGEST, (size_t)fields(m)[WRITTEN_SIZE]);
    fix(m->common, SECTION_WRITTEN, m->written, m->written);
    return MBD_OK;
}

/* -- verdict ------------------------------------------------------------------------------------------------------- */

#include "verdict.inc"
