/* Lines of motors and propellers, followed and taken out of samples: see core/tracking/line_removal.py. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "arrays.h"

#define TWO_PI 6.28318530717958647692
#define AMPLITUDE_RADPS (TWO_PI * 2.0) /* chosen: settles in 0.25 s */
#define PHASE_RADPS (TWO_PI * 4.0)     /* chosen: rpm that jumps by a tenth within half a second stays in lock */
#define K1 (2.0 * PHASE_RADPS)         /* derived, like the next two: Butterworth's polynomial */
#define K2 (2.0 * PHASE_RADPS * PHASE_RADPS)
#define K3 (PHASE_RADPS * PHASE_RADPS * PHASE_RADPS)
#define FLOOR 0.05       /* chosen, of the usual error squared: a line that is not yet seen turns nothing */
#define MAX_TURN_RAD 0.5 /* chosen: of psi; a larger one is no small angle */
#define MIN_PERIODS 0.1  /* chosen: no difference is taken across a shorter gap */
#define MAX_PERIODS 2.5  /* chosen: or across a longer one */
#define MIN_GAIN 0.002   /* chosen, |g|^2: samples that hardly differ along the line say nothing of it (34 Hz at 1 kHz) */
#define OMEGA_RATIO 0.3  /* chosen: a line this far from where the spectrum showed it is lost */
#define MAX_ALPHA_RADPS2 (TWO_PI * 100.0) /* chosen: of a harmonic; a shaft's inertia allows less */
#define MAX_ERRORS 6.0     /* chosen, of the mean magnitude: a blow or a lie is no line */
#define ERROR_MEMORY_S 0.5 /* chosen: a few periods of the wing */

typedef struct {
    double re, im;
} complex_number;

typedef struct {
    const array *anchor_radps, *omega_radps, *alpha_radps2, *phase_rad, *amplitude, *error, *weight;
} lines_record;

typedef struct {
    int64_t count, channels;
    const double *anchor, *weight;
    double *omega, *alpha, *phase, *error;
    complex_number *amplitude; /* (count, channels) */
    complex_number *g;
    double *turning, *power;
} lines;

/* Move phase, frequency and its rate of a line towards a phase error. */
static void turn(lines *l, int64_t j, double psi, double dt)
{
    l->phase[j] += K1 * psi * dt;
    l->omega[j] += K2 * psi * dt;
    l->alpha[j] = least(most(l->alpha[j] + K3 * psi * dt, -MAX_ALPHA_RADPS2), MAX_ALPHA_RADPS2);
    if (fabs(l->omega[j] / l->anchor[j] - 1.0) > OMEGA_RATIO) {
        l->omega[j] = l->anchor[j];
        l->alpha[j] = 0.0;
    }
}

/* Error within some times its usual magnitude, which follows: a blow or a lie is no line. */
static double limited(double *usual, double error, double dt)
{
    double size = fabs(error);
    if (*usual > 0.0)
        size = least(size, MAX_ERRORS * *usual);
    *usual += (size - *usual) * (*usual > 0.0 ? least(dt / ERROR_MEMORY_S, 1.0) : 1.0);
    return error < 0.0 ? -size : error > 0.0 ? size : error;
}

/* Turn each line on to the next sample, and find its second difference g there. */
static void go_on(lines *l, double dt, double before, double ratio, bool even)
{
    for (int64_t j = 0; j < l->count; j++) {
        if (even)
            l->omega[j] += l->alpha[j] * dt;
        double phase = fmod(l->phase[j] + l->omega[j] * dt, TWO_PI);
        l->phase[j] = phase < 0.0 ? phase + TWO_PI : phase;
        l->g[j] = (complex_number){0.0, 0.0};
        l->turning[j] = 0.0;
        l->power[j] = 1e-30;
        if (!even)
            continue;
        double back = -l->omega[j] * dt, twice = -l->omega[j] * (dt + before);
        double c = cos(l->phase[j]), s = sin(l->phase[j]), back_c = cos(back), back_s = sin(back);
        double re = 1.0 - back_c - ratio * (back_c - cos(twice)), im = -back_s - ratio * (back_s - sin(twice));
        l->g[j] = (complex_number){c * re - s * im, c * im + s * re};
    }
}

/* Fit the amplitudes of one channel to an error. */
static void fit_channel(lines *l, int64_t channel, double error, double dt)
{
    for (int64_t j = 0; j < l->count; j++) {
        const complex_number *a = &l->amplitude[j * l->channels + channel];
        error -= a->re * l->g[j].re - a->im * l->g[j].im;
    }
    error = limited(&l->error[channel], error, dt);
    for (int64_t j = 0; j < l->count; j++) {
        complex_number g = l->g[j], *a = &l->amplitude[j * l->channels + channel];
        double gain = squared(g.re) + squared(g.im);
        if (!(gain > MIN_GAIN))
            continue;
        double re = 2.0 * error * g.re / gain, im = -2.0 * error * g.im / gain;
        l->turning[j] += l->weight[channel] * (a->re * im - a->im * re);
        l->power[j] += l->weight[channel] *
                       (a->re * a->re + a->im * a->im + FLOOR * squared(l->error[channel]) / gain);
        a->re += AMPLITUDE_RADPS * dt * re;
        a->im += AMPLITUDE_RADPS * dt * im;
    }
}

static void clean_sample(lines *l, const int64_t *t_ns, const double *values, int64_t k, double period_s, double *out)
{
    int64_t channels = l->channels;
    double dt = k > 0 ? (double)(t_ns[k] - t_ns[k - 1]) * 1e-9 : period_s;
    double before = k > 1 ? (double)(t_ns[k - 1] - t_ns[k - 2]) * 1e-9 : INFINITY;
    double shorter = dt < before ? dt : before, longer = dt < before ? before : dt;
    bool even = shorter > MIN_PERIODS * period_s && longer < MAX_PERIODS * period_s;
    double ratio = even ? dt / before : 0.0;
    const double *here = values + k * channels;
    go_on(l, dt, before, ratio, even);
    for (int64_t c = 0; c < (even ? channels : 0); c++) {
        double last = here[c - channels];
        fit_channel(l, c, here[c] - last - ratio * (last - here[c - 2 * channels]), dt);
    }
    memcpy(out, here, (size_t)channels * sizeof *out);
    for (int64_t j = 0; j < l->count; j++) {
        if (even)
            turn(l, j, least(most(l->turning[j] / l->power[j], -MAX_TURN_RAD), MAX_TURN_RAD), dt);
        double cosine = cos(l->phase[j]), sine = sin(l->phase[j]);
        for (int64_t c = 0; c < channels; c++) {
            const complex_number *a = &l->amplitude[j * channels + c];
            out[c] -= a->re * cosine - a->im * sine;
        }
    }
}

static bool read_lines(const lines_record *record, lines *l)
{
    bool good = true;
    l->anchor = reals(record->anchor_radps, 1, &good);
    l->omega = reals(record->omega_radps, 1, &good);
    l->alpha = reals(record->alpha_radps2, 1, &good);
    l->phase = reals(record->phase_rad, 1, &good);
    l->amplitude = array_data(record->amplitude, 'D', 2, &good);
    l->error = reals(record->error, 1, &good);
    l->weight = reals(record->weight, 1, &good);
    if (!good)
        return false;
    l->count = extent(record->amplitude, 0);
    l->channels = extent(record->amplitude, 1);
    return extent(record->anchor_radps, 0) == l->count && extent(record->omega_radps, 0) == l->count &&
           extent(record->alpha_radps2, 0) == l->count && extent(record->phase_rad, 0) == l->count &&
           extent(record->error, 0) == l->channels && extent(record->weight, 0) == l->channels;
}

/* Samples (s, channels) from `first` on without their lines, which are followed in place. */
EXPORT int64_t lines_remove(const array *t_in, const array *values_in, int64_t first, double period_s,
                            const lines_record *record, const array *out_in)
{
    bool good = true;
    lines l;
    const int64_t *t_ns = integers(t_in, 1, &good);
    const double *values = reals(values_in, 2, &good);
    double *out = reals(out_in, 2, &good);
    int64_t samples = extent(t_in, 0);
    if (!good || !read_lines(record, &l) || first < 0 || extent(values_in, 0) != samples ||
        extent(values_in, 1) != l.channels || extent(out_in, 0) < samples - first || extent(out_in, 1) != l.channels)
        return BAD_ARRAY;
    l.turning = malloc((size_t)(l.count + 1) * (2 * sizeof(double) + sizeof(complex_number)));
    if (!l.turning)
        return NO_MEMORY;
    l.power = l.turning + l.count;
    l.g = (complex_number *)(l.power + l.count);
    for (int64_t k = first; k < samples; k++)
        clean_sample(&l, t_ns, values, k, period_s, out + (k - first) * l.channels);
    free(l.turning);
    return 0;
}
