/* watched.c: the native library with doors to what a verdict judges; see test_verdict.py. */
#include "mbd.c"

/* Where a number of the account lies, by `enum span`. */
MBD_API double *probe_span(mbd_model *m, int span) {
    const struct judged *j = (const struct judged *)part(m, LIMITS_AT);
    return (double *)in_written(m, j->span[span].at);
}

/* Look at a snapshot as that of step k. */
MBD_API void probe_look(mbd_model *m, int64_t k, const double *numbers) {
    m->run->k = k;
    memcpy(in_written(m, fields(m)[NUMBERS]), numbers, (size_t)fields(m)[NUMBERS_COUNT] * 8);
    look_at_snapshot(m);
}
