/* mbd.h: scenes of mbd_sim_ros without Python.
 *
 * A model is made from a file that `mbd build SCENE` wrote (SCENE.mbd) and stepped by the library that lies beside it
 * (libmbd.so). It gives the same bits as `mbd run SCENE`. All numbers are in SI units.
 *
 * Trust: a digest tells damage, not intent. Take models and states from whom you would take a program.
 *
 * Threads: a model is used by one thread at a time; different models know nothing of each other. The library has no
 * global state. mbd_step() allocates nothing, takes no lock and calls the system for nothing.
 *
 * Every function that can fail returns MBD_OK (0) or another code of `enum mbd_code`. mbd_text() says what a code means,
 * mbd_message() what went wrong last with a model: place, value and remedy.
 */
#ifndef MBD_H
#define MBD_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define MBD_API __attribute__((visibility("default")))

enum mbd_code {
    MBD_OK = 0,
    MBD_FILE,          /* the file cannot be read */
    MBD_DAMAGED,       /* not a model or a state, or damaged on its way */
    MBD_VERSION,       /* written by another version */
    MBD_KERNELS,       /* the library lacks kernels of the model */
    MBD_PROCESSOR,     /* the processor lacks instructions that the library uses */
    MBD_MEMORY,        /* no memory */
    MBD_ARGUMENT,      /* an argument that makes no sense: see mbd_message() */
    MBD_OTHER_MODEL,   /* the state is that of another model */
    MBD_ENDED,         /* the maneuver of the scene has ended, and inputs still follow it */
    MBD_INPUT,         /* an input is not finite; nothing was advanced */
    MBD_NOT_CONVERGED, /* a step did not converge; the model is as it was before that step */
    MBD_NOT_FINITE,    /* the motion is no longer finite; as above */
    MBD_SINGULAR,      /* the matrix of a step is singular; as above */
    MBD_INACCURATE,    /* the error stays above the tolerance; as above */
    MBD_INTERNAL       /* an error of the program */
};

enum mbd_kind {
    MBD_INPUT_KIND = 0, /* set by the caller, or by the maneuver of the scene until then */
    MBD_OUTPUT,         /* what is recorded and published after a step, under the name of its column */
    MBD_ACCOUNT,        /* the running account: energies, residuals, largest values so far */
    MBD_COUNTER         /* steps, iterations and the like so far */
};

typedef struct mbd_model mbd_model;

/* Make a model from a file, or from its content; *model is NULL after a failure. The content may be freed afterwards.
 * The model is at the start of its scene. */
MBD_API int mbd_open(const char *path, mbd_model **model);
MBD_API int mbd_make(const void *content, size_t size, mbd_model **model);
/* Another model in the same state; they share what is never written. */
MBD_API int mbd_copy(const mbd_model *model, mbd_model **copy);
MBD_API void mbd_free(mbd_model *model); /* NULL is allowed */

MBD_API const char *mbd_text(int code);
MBD_API const char *mbd_message(const mbd_model *model);
MBD_API const char *mbd_scene(const mbd_model *model);   /* name of the scene */
MBD_API const char *mbd_version(const mbd_model *model); /* of the program that wrote the model */

/* Variables: inputs, outputs, account and counters, numbered from 0. mbd_find() gives -1 for an unknown name. */
MBD_API int mbd_variables(const mbd_model *model);
MBD_API int mbd_find(const mbd_model *model, const char *name);
MBD_API const char *mbd_name(const mbd_model *model, int variable);
MBD_API const char *mbd_unit(const mbd_model *model, int variable);
MBD_API int mbd_kind(const mbd_model *model, int variable); /* enum mbd_kind, -1 for none */
MBD_API int mbd_get(const mbd_model *model, int variable, double *value);

/* Inputs. An input follows the maneuver of the scene until it is set, and holds what was set. The angle of the steering
 * wheel is a command: it passes the filter of the node (critically damped, mbd_filter()), so that angle, rate and
 * acceleration belong together. Other prescribed motions are set with their rate and acceleration, at the end of the
 * next step; mbd_set() refuses them. mbd_follow() gives an input back to the maneuver. */
MBD_API int mbd_set(mbd_model *model, int input, double value);
MBD_API int mbd_set_motion(mbd_model *model, int input, double value, double rate, double acceleration);
MBD_API int mbd_follow(mbd_model *model, int input);
MBD_API int mbd_filter(mbd_model *model, double bandwidth_hz, double rate_limit); /* 5 Hz, 20 rad/s at first */

/* Time. n steps of mbd_h() seconds; fewer after a failure: mbd_steps() says how many since the start. */
MBD_API int mbd_step(mbd_model *model, int64_t n);
MBD_API double mbd_h(const mbd_model *model);
MBD_API int64_t mbd_h_ns(const mbd_model *model);
MBD_API int64_t mbd_steps(const mbd_model *model);
MBD_API double mbd_time(const mbd_model *model);
MBD_API int64_t mbd_duration(const mbd_model *model); /* steps that the scene has */
/* Whether the account is kept, which is needed for a verdict (1, at first) or not (0), which is faster. */
MBD_API void mbd_audit(mbd_model *model, int on);

/* State: all that the future depends on, and the account. mbd_save() writes mbd_size() bytes, which another process can
 * restore, with the same library and the same model. Equal states have equal bytes. */
MBD_API int mbd_reset(mbd_model *model); /* back to the start of the scene */
MBD_API size_t mbd_size(const mbd_model *model);
MBD_API int mbd_save(const mbd_model *model, void *buffer, size_t size);
MBD_API int mbd_restore(mbd_model *model, const void *buffer, size_t size);

/* The numbers of the last snapshot, as `Snapshot.numbers` holds them: the outputs, one behind the other. */
MBD_API const double *mbd_numbers(const mbd_model *model, size_t *count);

/* Verdict on the steps so far: the number of findings. 0 is ok; with more the run is suspect, and mbd_message() has the
 * first one, as `mbd run` words it: what is wrong and where, value and limit, what to do. mbd_finding() gives every one,
 * from 0 on, and "" behind the last; it stays until the next call with this model. The checks are those of `mbd run` but
 * for the ones that mbd_unchecked() names: an ok does not say that the numerical error is small. */
MBD_API int mbd_verdict(mbd_model *model);
MBD_API const char *mbd_finding(mbd_model *model, int finding);
MBD_API const char *mbd_unchecked(const mbd_model *model);

/* A function that is told of what happens in a step besides: changes of steps and penalties. NULL: nobody is. */
typedef void (*mbd_logger)(void *user, const char *sentence);
MBD_API void mbd_log(mbd_model *model, mbd_logger logger, void *user);

#ifdef __cplusplus
}
#endif
#endif
