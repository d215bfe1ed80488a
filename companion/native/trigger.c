/* Predicted blur and its minima: see core/trigger/blur.py and core/trigger/instants.py for the equations. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "arrays.h"

#define WORST_SIGMA_NS 1e9 /* keeps an unknown time finite */

typedef struct {
    const array *by_rate, *by_velocity, *by_lever; /* (2, 3, 3) */
    const array *by_slope, *by_lift;               /* (2, 3) */
    const array *exposure_s;                       /* (2,) */
    double px;
} motion_maps;

typedef struct {
    const array *image, *per_rate, *acceleration, *rms; /* (n, 2, 3), (2, 3), (n, 2), (n, 2) */
} streaks;

static double dot3(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* Slope acceleration (n, 2) of equally spaced instants, by central differences. */
static void differentiate(const double *rates, int64_t n, double step_s, double *out)
{
    for (int side = 0; side < 2; side++) {
        for (int64_t k = 1; k + 1 < n; k++)
            out[2 * k + side] = (rates[2 * k + 2 + side] - rates[2 * k - 2 + side]) / (2 * step_s);
        out[side] = (rates[2 + side] - rates[side]) / step_s;
        out[2 * n - 2 + side] = (rates[2 * n - 2 + side] - rates[2 * n - 4 + side]) / step_s;
    }
}

/* Image motion, what a slope rate adds to it, slope accelerations and expected rms blur over n > 1 instants. */
EXPORT int64_t trigger_streaks(const motion_maps *motion_maps, const array *rates_in, const array *covariance_in,
                               double step_s, const array *shifts_ns_in, const array *sigmas_ns_in,
                               const array *body_rate_in, const array *velocity_in, double nearness,
                               const streaks *out)
{
    bool good = true;
    const double *by_rate = reals(motion_maps->by_rate, 3, &good);
    const double *by_velocity = reals(motion_maps->by_velocity, 3, &good);
    const double *by_lever = reals(motion_maps->by_lever, 3, &good), *by_slope = reals(motion_maps->by_slope, 2, &good);
    const double *by_lift = reals(motion_maps->by_lift, 2, &good);
    const double *exposure_s = reals(motion_maps->exposure_s, 1, &good);
    const double *rates = reals(rates_in, 2, &good), *covariance = reals(covariance_in, 3, &good);
    const double *shifts_ns = reals(shifts_ns_in, 1, &good), *sigmas_ns = reals(sigmas_ns_in, 1, &good);
    const double *body_rate = reals(body_rate_in, 1, &good), *velocity = reals(velocity_in, 1, &good);
    double *image = reals(out->image, 3, &good), *per_rate = reals(out->per_rate, 2, &good);
    double *acceleration = reals(out->acceleration, 2, &good), *rms = reals(out->rms, 2, &good);
    int64_t n = extent(rates_in, 0);
    if (!good || n < 2 || extent(covariance_in, 0) < n || extent(out->image, 0) < n)
        return BAD_ARRAY;
    differentiate(rates, n, step_s, acceleration);
    for (int side = 0; side < 2; side++) {
        double rigid[3], sum = 0.0, timing = squared(sigmas_ns[side] * 1e-9) + squared(exposure_s[side]) / 12.0;
        for (int axis = 0; axis < 3; axis++) {
            int at = 3 * side + axis;
            rigid[axis] = dot3(by_rate + 3 * at, body_rate) +
                          nearness * (dot3(by_velocity + 3 * at, velocity) + dot3(by_lever + 3 * at, body_rate));
            per_rate[at] = by_slope[at] + nearness * by_lift[at];
            sum += squared(per_rate[at]);
        }
        for (int64_t k = 0; k < n; k++) {
            double slope_acceleration = acceleration[2 * k + side];
            double rate = rates[2 * k + side] + slope_acceleration * (shifts_ns[side] * 1e-9);
            double square = (covariance[4 * k + 3 * side] + squared(slope_acceleration) * timing) * sum;
            for (int axis = 0; axis < 3; axis++) {
                double moved = rigid[axis] + per_rate[3 * side + axis] * rate;
                image[6 * k + 3 * side + axis] = moved;
                square += squared(moved);
            }
            rms[2 * k + side] = motion_maps->px * sqrt(square);
        }
    }
    return 0;
}

typedef struct {
    const array *t_ns;                              /* (n,) */
    const array *motion, *per_rate, *acceleration; /* (n, 2, 3), (2, 3), (n, 2) */
    const array *rate_covariance, *q_covariance;    /* (n, 2, 2) */
    const array *spring, *rms_px;                   /* (2, 2), (n, 2) */
} blur;

/* The larger of two roots whose squares are known at three instants, (2,) each, by parabolas. */
static double root_between(const double *rms, double fraction)
{
    double largest = -INFINITY;
    for (int side = 0; side < 2; side++) {
        double before = squared(rms[side]), at = squared(rms[2 + side]), after = squared(rms[4 + side]);
        largest = most(largest, at + fraction * (after - before) / 2.0 +
                                    squared(fraction) * (after - 2.0 * at + before) / 2.0);
    }
    return sqrt(most(largest, 0.0));
}

/* Variance of dJ/dt = sum of 2 (motion . per_rate) x' at the minimum, from those of x and x'. */
static double slope_variance(const double *motion, const double *per_rate, const double *acceleration,
                             const double *rate_covariance, const double *q_covariance, const double *spring)
{
    double by_rate[2], along[2], by_q[2], variance = 0.0;
    for (int side = 0; side < 2; side++) {
        by_rate[side] = 2.0 * dot3(per_rate + 3 * side, per_rate + 3 * side) * acceleration[side];
        along[side] = 2.0 * dot3(motion + 3 * side, per_rate + 3 * side);
    }
    for (int i = 0; i < 2; i++)
        by_q[i] = along[0] * spring[i] + along[1] * spring[2 + i];
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) {
            variance += by_rate[i] * by_rate[j] * rate_covariance[2 * i + j];
            variance += by_q[i] * by_q[j] * q_covariance[2 * i + j];
        }
    return variance;
}

/* Time and its sigma, in ns, and rms blur of each minimum, into (n, 3); how many there are. Times count from the first
 * instant. */
EXPORT int64_t trigger_minima(const blur *blur, int64_t from_ns, const array *minima_out)
{
    bool good = true;
    const int64_t *t_ns = integers(blur->t_ns, 1, &good);
    const double *motion = reals(blur->motion, 3, &good), *per_rate = reals(blur->per_rate, 2, &good);
    const double *acceleration = reals(blur->acceleration, 2, &good), *spring = reals(blur->spring, 2, &good);
    const double *rate_covariance = reals(blur->rate_covariance, 3, &good);
    const double *q_covariance = reals(blur->q_covariance, 3, &good), *rms = reals(blur->rms_px, 2, &good);
    double *minima = reals(minima_out, 2, &good);
    int64_t n = extent(blur->t_ns, 0), count = 0;
    if (!good || extent(blur->motion, 0) < n || extent(minima_out, 0) < n)
        return BAD_ARRAY;
    double *energy = malloc((size_t)(n + 1) * sizeof *energy);
    if (!energy)
        return NO_MEMORY;
    for (int64_t k = 0; k < n; k++) {
        energy[k] = 0.0;
        for (int at = 0; at < 6; at++)
            energy[k] += squared(motion[6 * k + at]);
    }
    for (int64_t i = 1; i + 1 < n; i++) {
        if (!(energy[i] <= energy[i - 1] && energy[i] < energy[i + 1] && t_ns[i] >= from_ns))
            continue;
        double step_ns = (double)(t_ns[i + 1] - t_ns[i]), middle[6];
        double bend = energy[i - 1] - 2.0 * energy[i] + energy[i + 1];
        double fraction = 0.5 * (energy[i - 1] - energy[i + 1]) / bend;
        for (int at = 0; at < 6; at++)
            middle[at] = motion[6 * i + at] + fraction * (motion[6 * i + 6 + at] - motion[6 * i - 6 + at]) / 2.0;
        double variance = slope_variance(middle, per_rate, acceleration + 2 * i, rate_covariance + 4 * i,
                                         q_covariance + 4 * i, spring);
        double sigma_ns = sqrt(variance) / (bend / squared(step_ns * 1e-9)) * 1e9;
        minima[3 * count] = (double)(t_ns[i] - t_ns[0]) + fraction * step_ns;
        minima[3 * count + 1] = least(sigma_ns, WORST_SIGMA_NS);
        minima[3 * count + 2] = root_between(rms + 2 * (i - 1), fraction);
        count++;
    }
    free(energy);
    return count;
}
