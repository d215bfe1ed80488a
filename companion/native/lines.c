/* Lines of motors and propellers, followed and taken out of samples: see core/tracking/line_removal.py. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "linear.h"

#define TWO_PI 6.28318530717958647692
#define AMPLITUDE_RADPS (TWO_PI * 2.0) /* chosen: settles in 0.25 s */
#define SLOWER_BELOW_RADPS (TWO_PI * 45.0) /* chosen: below, amplitudes follow slower, for the wing's sake */
#define PARTS 12 /* of a leader's turn: line_removal.PARTS */
#define PHASE_RADPS (TWO_PI * 4.0)     /* chosen: rpm that jumps by a tenth within half a second stays in lock */
#define K1 (2.0 * PHASE_RADPS)         /* derived, like the next two: Butterworth's polynomial */
#define K2 (2.0 * PHASE_RADPS * PHASE_RADPS)
#define K3 (PHASE_RADPS * PHASE_RADPS * PHASE_RADPS)
#define CALM_RADPS (TWO_PI * 8.0) /* chosen: twice the loop's, and below the beats of the wing with a line */
#define FLOOR 0.05       /* chosen, of the usual error squared: a line that is not yet seen turns nothing */
#define MAX_TURN_RAD 0.5 /* chosen: of psi; a larger one is no small angle */
#define MIN_PERIODS 0.1  /* chosen, of the lag: no difference is taken across a shorter gap */
#define MAX_PERIODS 2.5  /* chosen: or across a longer one */
#define MIN_GAIN 0.02    /* chosen, |g|^2: samples that hardly differ along the line say nothing of it */
#define OMEGA_RATIO 0.55  /* chosen: a line this far from where the last search left it is lost */
#define MAX_ALPHA_RADPS2 (TWO_PI * 100.0) /* chosen: of a harmonic; a shaft's inertia allows less */
#define MAX_ERRORS 6.0     /* chosen, of the mean magnitude: a blow or a lie is no line */
#define ERROR_MEMORY_S 0.5 /* chosen: a few periods of the wing */

typedef struct {
    double re, im;
} complex_number;

typedef struct {
    const array *anchor_radps, *omega_radps, *alpha_radps2, *phase_rad, *ahead_rad, *led, *shaft, *multiple, *amplitude,
        *error, *weight;
    int64_t lag;
} lines_record;

typedef struct {
    int64_t shafts, count, channels, lag;
    const double *anchor, *weight; /* of shafts, of channels */
    double *omega, *alpha, *phase, *ahead; /* of shafts */
    const int64_t *led; /* of shafts */
    const int64_t *shaft, *multiple; /* of lines */
    double *error;
    complex_number *amplitude; /* (count, channels) */
    complex_number *g; /* of lines */
    double *turning, *power; /* of shafts */
} lines;

/* Move phase, frequency and its rate of a shaft by a phase error of its leader, and how far the phase is ahead of a
 * calmer one: the wing's motion in one channel would else come out in all that have the line. */
static void turn(lines *l, int64_t i, double psi, double dt)
{
    double part = psi / PARTS, limit = MAX_ALPHA_RADPS2 / PARTS;
    l->phase[i] += K1 * part * dt;
    l->ahead[i] = (l->ahead[i] + K1 * part * dt) / (1.0 + CALM_RADPS * dt);
    l->omega[i] += K2 * part * dt;
    l->alpha[i] = least(most(l->alpha[i] + K3 * part * dt, -limit), limit);
    if (fabs(l->omega[i] / l->anchor[i] - 1.0) > OMEGA_RATIO) {
        l->omega[i] = l->anchor[i];
        l->alpha[i] = 0.0;
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

/* Turn each shaft on to the next sample, and find the second difference g of each of its lines there. */
static void go_on(lines *l, double dt, double after, double before, double ratio, bool even)
{
    for (int64_t i = 0; i < l->shafts; i++) {
        if (even)
            l->omega[i] += l->alpha[i] * dt;
        double phase = fmod(l->phase[i] + l->omega[i] * dt, TWO_PI);
        l->phase[i] = phase < 0.0 ? phase + TWO_PI : phase;
        l->turning[i] = 0.0;
        l->power[i] = 1e-30;
    }
    for (int64_t j = 0; j < l->count; j++) {
        l->g[j] = (complex_number){0.0, 0.0};
        if (!even)
            continue;
        double times = (double)l->multiple[j], phase = times * l->phase[l->shaft[j]];
        double step = times * l->omega[l->shaft[j]], back = -step * after, twice = -step * (after + before);
        double c = cos(phase), s = sin(phase), back_c = cos(back), back_s = sin(back);
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
        int64_t i = l->shaft[j];
        double re = 2.0 * error * g.re / gain, im = -2.0 * error * g.im / gain;
        double turns = (double)l->multiple[j] / PARTS; /* of the line in one of the leader's */
        double weight = least(l->weight[channel], 1.0 / squared(l->error[channel])); /* gusts are no line's phase */
        double power = a->re * a->re + a->im * a->im, besides = squared(l->error[channel]) / gain;
        /* a channel whose line is far below the wing's motion would pull the phase to that */
        weight *= gain * power / (power + besides + 1e-30);
        l->turning[i] += weight * turns * (a->re * im - a->im * re);
        l->power[i] += weight * squared(turns) * (power + FLOOR * besides);
        double slower = least((double)l->multiple[j] * l->anchor[i] / SLOWER_BELOW_RADPS, 1.0);
        a->re += slower * AMPLITUDE_RADPS * dt * re;
        a->im += slower * AMPLITUDE_RADPS * dt * im;
    }
}

/* Seconds between two samples a lag apart, the later one of this number; infinite without an earlier one. */
static double lag_s(const int64_t *t_ns, int64_t k, int64_t lag)
{
    return k >= lag ? (double)(t_ns[k] - t_ns[k - lag]) * 1e-9 : INFINITY;
}

static void clean_sample(lines *l, const int64_t *t_ns, const double *values, int64_t k, double period_s, double *out)
{
    int64_t channels = l->channels, back = l->lag * channels;
    double dt = k > 0 ? (double)(t_ns[k] - t_ns[k - 1]) * 1e-9 : period_s, usual = period_s * (double)l->lag;
    double after = lag_s(t_ns, k, l->lag), before = k >= l->lag ? lag_s(t_ns, k - l->lag, l->lag) : INFINITY;
    double shorter = least(after, before), longer = most(after, before);
    bool even = shorter > MIN_PERIODS * usual && longer < MAX_PERIODS * usual && dt < MAX_PERIODS * period_s;
    double ratio = even ? after / before : 0.0;
    const double *here = values + k * channels;
    go_on(l, dt, after, before, ratio, even);
    for (int64_t c = 0; c < (even ? channels : 0); c++) {
        double last = here[c - back];
        fit_channel(l, c, here[c] - last - ratio * (last - here[c - 2 * back]), dt);
    }
    memcpy(out, here, (size_t)channels * sizeof *out);
    for (int64_t i = 0; i < (even ? l->shafts : 0); i++)
        turn(l, i, l->led[i] ? 0.0 : least(most(l->turning[i] / l->power[i], -MAX_TURN_RAD), MAX_TURN_RAD), dt);
    for (int64_t j = 0; j < l->count; j++) {
        double calm = l->phase[l->shaft[j]] - l->ahead[l->shaft[j]], phase = (double)l->multiple[j] * calm;
        double cosine = cos(phase), sine = sin(phase);
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
    l->ahead = reals(record->ahead_rad, 1, &good);
    l->led = integers(record->led, 1, &good);
    l->shaft = integers(record->shaft, 1, &good);
    l->multiple = integers(record->multiple, 1, &good);
    l->amplitude = array_data(record->amplitude, 'D', 2, &good);
    l->error = reals(record->error, 1, &good);
    l->weight = reals(record->weight, 1, &good);
    if (!good)
        return false;
    l->shafts = extent(record->anchor_radps, 0);
    l->count = extent(record->amplitude, 0);
    l->channels = extent(record->amplitude, 1);
    l->lag = record->lag;
    good = good && l->lag > 0;
    for (int64_t j = 0; j < extent(record->shaft, 0); j++)
        good = good && l->shaft[j] >= 0 && l->shaft[j] < l->shafts;
    return good && extent(record->omega_radps, 0) == l->shafts && extent(record->alpha_radps2, 0) == l->shafts &&
           extent(record->ahead_rad, 0) == l->shafts && extent(record->led, 0) == l->shafts &&
           extent(record->phase_rad, 0) == l->shafts && extent(record->shaft, 0) == l->count &&
           extent(record->multiple, 0) == l->count && extent(record->error, 0) == l->channels &&
           extent(record->weight, 0) == l->channels;
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
    l.turning = malloc((size_t)(l.shafts + 1) * 2 * sizeof(double) + (size_t)l.count * sizeof(complex_number));
    if (!l.turning)
        return NO_MEMORY;
    l.power = l.turning + l.shafts;
    l.g = (complex_number *)(l.power + l.shafts);
    for (int64_t k = first; k < samples; k++)
        clean_sample(&l, t_ns, values, k, period_s, out + (k - first) * l.channels);
    free(l.turning);
    return 0;
}

/* Mean and variance, (2,), of the squared envelope of samples (n,) that are turned back by a frequency, in windows (w,)
 * that begin `hop` apart (core/tracking/line_search.py). */
EXPORT int64_t lines_envelope(const array *samples_in, const array *t_in, double frequency_hz, const array *window_in,
                              int64_t hop, const array *out_in)
{
    bool good = true;
    const double *samples = reals(samples_in, 1, &good), *t_s = reals(t_in, 1, &good);
    const double *window = reals(window_in, 1, &good);
    double *out = reals(out_in, 1, &good);
    if (!good)
        return BAD_ARRAY;
    int64_t n = extent(samples_in, 0), w = extent(window_in, 0);
    if (extent(t_in, 0) != n || extent(out_in, 0) != 2 || w < 1 || w > n || hop < 1)
        return BAD_ARRAY;
    int64_t count = (n - w) / hop + 1;
    double *re = malloc((size_t)(2 * n + count) * sizeof *re), *im = re + n, *squares = im + n;
    if (!re)
        return NO_MEMORY;
    for (int64_t k = 0; k < n; k++) {
        double turn = TWO_PI * frequency_hz * t_s[k];
        re[k] = samples[k] * cos(turn);
        im[k] = -samples[k] * sin(turn);
    }
    double mean = 0.0, variance = 0.0;
    for (int64_t k = 0; k < count; k++) {
        squares[k] = squared(dot(re + k * hop, window, w)) + squared(dot(im + k * hop, window, w));
        mean += squares[k] / (double)count;
    }
    for (int64_t k = 0; k < count; k++)
        variance += squared(squares[k] - mean) / (double)count;
    free(re);
    out[0] = mean;
    out[1] = variance;
    return 0;
}
