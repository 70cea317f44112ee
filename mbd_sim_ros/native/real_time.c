/* real_time.c: drives a model in real time, one step a millisecond, and says how late its steps were.
 *
 *     mbd build car_step_steer --out native && cd native
 *     cc -O2 real_time.c -o real_time -L. -lmbd -lm -Wl,-rpath,'$ORIGIN'
 *     ./real_time car_step_steer.mbd 5
 *
 * The first argument is the model, the second how many seconds to drive. A third one, a number of degrees, turns the
 * steering wheel after one second instead of the maneuver of the scene; the filter of mbd_set() makes a motion of it.
 */
#define _POSIX_C_SOURCE 200809L
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "mbd.h"

static const double NS = 1e-9;

static double seconds(struct timespec t) { return (double)t.tv_sec + NS * (double)t.tv_nsec; }

static int by_size(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static int stopped(const char *what, const char *why) {
    fprintf(stderr, "real_time: %s: %s\n", what, why);
    return 1;
}

int main(int argc, char **argv) {
    if (argc < 3) return stopped("usage", "real_time MODEL SECONDS [DEGREES]");

    mbd_model *car;
    int code = mbd_open(argv[1], &car);
    if (code != MBD_OK) return stopped(argv[1], mbd_text(code));

    double h = mbd_h(car);
    long steps = (long)(atof(argv[2]) / h + 0.5);
    if (steps < 1) return stopped(argv[2], "give a number of seconds above 0");

    /* Variables are found once, by the names of their columns in recordings. */
    int wheel = mbd_find(car, "steering");
    int speed = mbd_find(car, "odom/twist/vx"), yaw = mbd_find(car, "odom/twist/wz");
    char *end = NULL;
    double angle = argc > 3 ? strtod(argv[3], &end) * 3.14159265358979 / 180.0 : 0.0;
    if (argc > 3 && (end == argv[3] || *end != 0)) return stopped(argv[3], "give a number of degrees");
    if (argc > 3 && wheel < 0) return stopped(argv[1], "the model has no input \"steering\": leave out the degrees");

    double *late = calloc((size_t)steps, sizeof *late), *busy = calloc((size_t)steps, sizeof *busy);
    if (late == NULL || busy == NULL) return stopped("memory", "there is none left");

    struct timespec begin, now, due;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    for (long k = 0; k < steps; k++) {
        /* Step k is due k h after the beginning; its outputs are those of an instant h later. */
        double at = (double)k * h;
        due.tv_sec = begin.tv_sec + (time_t)at;
        due.tv_nsec = begin.tv_nsec + (long)((at - (double)(time_t)at) / NS);
        if (due.tv_nsec >= 1000000000L) due.tv_sec++, due.tv_nsec -= 1000000000L;
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL) == EINTR) continue;

        clock_gettime(CLOCK_MONOTONIC, &now);
        late[k] = seconds(now) - seconds(due);
        code = argc > 3 && at >= 1.0 ? mbd_set(car, wheel, angle) : MBD_OK;
        if (code == MBD_OK) code = mbd_step(car, 1);
        if (code != MBD_OK) return stopped("step", mbd_message(car));
        clock_gettime(CLOCK_MONOTONIC, &due);
        busy[k] = seconds(due) - seconds(now);
    }

    long over = 0; /* steps that ended after the next one was due */
    for (long k = 0; k < steps; k++) over += late[k] + busy[k] > h;
    double vx = 0.0, wz = 0.0;
    printf("%s: %ld steps of %g ms; at t = %g s", mbd_scene(car), steps, 1e3 * h, mbd_time(car));
    if (mbd_get(car, speed, &vx) == MBD_OK && mbd_get(car, yaw, &wz) == MBD_OK) printf(" %.3f m/s, yaw rate %.4f rad/s", vx, wz);
    printf("\n");
    qsort(late, (size_t)steps, sizeof *late, by_size);
    qsort(busy, (size_t)steps, sizeof *busy, by_size);
    printf("late [us]: median %.0f, 99 %% %.0f, most %.0f\n", 1e6 * late[steps / 2], 1e6 * late[steps * 99 / 100],
           1e6 * late[steps - 1]);
    printf("busy [us]: median %.0f, 99 %% %.0f, most %.0f\n", 1e6 * busy[steps / 2], 1e6 * busy[steps * 99 / 100],
           1e6 * busy[steps - 1]);
    printf("late steps, which ended after the next one was due: %.3g %%\n", 100.0 * (double)over / (double)steps);
    printf("verdict: %s%s\n", mbd_verdict(car) ? "suspect: " : "ok", mbd_message(car));
    printf("not checked here: %s\n", mbd_unchecked(car));

    free(late);
    free(busy);
    mbd_free(car);
    return 0;
}
