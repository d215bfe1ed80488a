/* Kalman filters of many hypotheses, one after the other: see diagnosis/free_decay/kalman.py. */
#include <stdlib.h>
#include <string.h>

#include "arrays.h"
#include "linear.h"

/* Steps of that file. */
typedef struct {
    const array *transition, *process_noise, *H, *cross_covariance, *noise, *start;
} steps_record;

typedef struct {
    const double *transition, *process_noise, *H, *cross_covariance, *noise; /* (t, b, ...) */
    int64_t count, batch, n;
    double *x, *moved, *ph, *gain, *p, *half; /* (n,) each; (n, n) each */
} filters;

/* One step of hypothesis b; its innovation and the variance of this. */
static void step(filters *f, int64_t t, int64_t b, double y, double *innovation, double *variance)
{
    int64_t n = f->n, at = t * f->batch + b;
    const double *A = f->transition + at * n * n, *Q = f->process_noise + at * n * n, *H = f->H + at * n;
    double s = f->noise[at] + 0.0, e = y - dot(f->x, H, n);
    for (int64_t i = 0; i < n; i++)
        f->ph[i] = dot(f->p + i * n, H, n);
    s += dot(f->ph, H, n);
    for (int64_t i = 0; i < n; i++) {
        f->gain[i] = (f->cross_covariance[at * n + i] + dot(A + i * n, f->ph, n)) / s;
        f->moved[i] = dot(A + i * n, f->x, n);
    }
    for (int64_t i = 0; i < n; i++)
        f->x[i] = f->moved[i] + f->gain[i] * e;
    multiply(A, f->p, n, n, n, f->half);
    multiply_transposed(f->half, A, n, n, n, f->p);
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < n; j++)
            f->p[i * n + j] += Q[i * n + j] - f->gain[i] * f->gain[j] * s;
    *innovation = e;
    *variance = s;
}

/* Innovations and their variances (t, b) and states (t, b, n) of readings y (t, b); at first the state is 0 with the
 * variances `start`. */
EXPORT int64_t decay_filter(const steps_record *steps, const array *y_in, const array *innovation_out,
                            const array *variance_out, const array *state_out)
{
    bool good = true;
    filters f = {.transition = reals(steps->transition, 4, &good),
                 .process_noise = reals(steps->process_noise, 4, &good),
                 .H = reals(steps->H, 3, &good),
                 .cross_covariance = reals(steps->cross_covariance, 3, &good),
                 .noise = reals(steps->noise, 2, &good)};
    const double *y = reals(y_in, 2, &good), *start = reals(steps->start, 2, &good);
    double *innovation = reals(innovation_out, 2, &good), *variance = reals(variance_out, 2, &good);
    double *state = reals(state_out, 3, &good);
    if (!good)
        return BAD_ARRAY;
    f.count = extent(steps->H, 0);
    f.batch = extent(steps->H, 1);
    int64_t n = f.n = extent(steps->H, 2);
    const array *all[] = {steps->transition, steps->process_noise, steps->cross_covariance, steps->noise,
                          y_in,              innovation_out,       variance_out,            state_out};
    for (size_t k = 0; k < sizeof all / sizeof *all; k++)
        if (extent(all[k], 0) < f.count || extent(all[k], 1) != f.batch)
            return BAD_ARRAY;
    if (extent(steps->transition, 2) != n || extent(steps->transition, 3) != n || extent(state_out, 2) != n ||
        extent(steps->start, 0) != f.batch || extent(steps->start, 1) != n)
        return BAD_ARRAY;
    f.x = malloc((size_t)(4 * n + 2 * n * n + 1) * sizeof *f.x);
    if (!f.x)
        return NO_MEMORY;
    f.moved = f.x + n;
    f.ph = f.moved + n;
    f.gain = f.ph + n;
    f.p = f.gain + n;
    f.half = f.p + n * n;
    for (int64_t b = 0; b < f.batch; b++) {
        memset(f.x, 0, (size_t)n * sizeof *f.x);
        memset(f.p, 0, (size_t)(n * n) * sizeof *f.p);
        for (int64_t i = 0; i < n && f.count; i++)
            f.p[i * n + i] = start[b * n + i];
        for (int64_t t = 0; t < f.count; t++) {
            int64_t at = t * f.batch + b;
            step(&f, t, b, y[at], innovation + at, variance + at);
            memcpy(state + at * n, f.x, (size_t)n * sizeof *f.x);
        }
    }
    free(f.x);
    return 0;
}
