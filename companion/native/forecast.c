/* The wing without measurements (core/tracking/prediction.py), and one mode as an oscillation (estimates.py). */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "arrays.h"
#include "linear.h"

#define PI 3.14159265358979323846

/* E A^k into (m, count, n) and E W_k E^T into (m, m, count) for the selected states E (m,). */
EXPORT int64_t forecast_powers(const array *transition_in, const array *noise_in, const array *states_in,
                               const array *powers_out, const array *noise_out)
{
    bool good = true;
    const double *A = reals(transition_in, 2, &good), *Q = reals(noise_in, 2, &good);
    const int64_t *states = integers(states_in, 1, &good);
    double *powers = reals(powers_out, 3, &good), *summed = reals(noise_out, 3, &good);
    int64_t n = extent(transition_in, 0), m = extent(states_in, 0), count = extent(powers_out, 1);
    if (!good || extent(transition_in, 1) != n || extent(noise_in, 0) != n || extent(noise_in, 1) != n ||
        extent(powers_out, 0) != m || extent(powers_out, 2) != n || extent(noise_out, 0) != m ||
        extent(noise_out, 1) != m || extent(noise_out, 2) != count)
        return BAD_ARRAY;
    double *rows = calloc((size_t)(2 * m * n + 2 * n * n), sizeof *rows);
    if (!rows)
        return NO_MEMORY;
    double *moved = rows + m * n, *covariance = moved + m * n, *product = covariance + n * n;
    for (int64_t i = 0; i < m; i++)
        rows[i * n + states[i]] = 1.0;
    for (int64_t k = 0; k < count; k++) {
        multiply(rows, A, m, n, n, moved);
        memcpy(rows, moved, (size_t)(m * n) * sizeof *rows);
        multiply(A, covariance, n, n, n, product);
        multiply_transposed(product, A, n, n, n, covariance);
        add_scaled(covariance, Q, 1.0, n * n);
        for (int64_t i = 0; i < m; i++) {
            memcpy(powers + (i * count + k) * n, rows + i * n, (size_t)n * sizeof *rows);
            for (int64_t j = 0; j < m; j++)
                summed[(i * m + j) * count + k] = covariance[states[i] * n + states[j]];
        }
    }
    free(rows);
    return 0;
}

/* _OutputIndices of prediction.py. */
typedef struct {
    const array *modal_states, *q;
    int64_t static_state;
    const array *constant, *rate, *signs;
} indices_record;

/* _FilterSnapshot of prediction.py. */
typedef struct {
    const array *state_and_sensitivity, *one_and_bias, *covariance, *bias_parameter_covariance;
} snapshot_record;

enum { OUTPUTS = 4 }; /* both modal coordinates, both slope rates */

typedef struct {
    const int64_t *modal_states, *q, *constant, *rate;
    const double *signs, *powers, *noise, *slope, *x, *one_and_bias, *P, *bias_covariance;
    int64_t static_state, factors, m, count, n, states, width;
    double *outputs, *static_modal, *deviation, *covariance, *rows, *projected, *outputs_noise;
} forecast;

/* Rows of modal coordinates and slope rates, slope factors as estimated, on the modal states, (4, m). */
static void find_outputs(forecast *f)
{
    memset(f->outputs, 0, (size_t)(OUTPUTS * f->m) * sizeof(double));
    for (int side = 0; side < 2; side++) {
        double *rate = f->outputs + (2 + side) * f->m;
        f->outputs[side * f->m + f->q[side]] = 1.0;
        memcpy(rate, f->slope + side * f->m, (size_t)f->m * sizeof(double));
        for (int64_t k = 0; k < f->factors; k++)
            rate[f->rate[k]] += f->signs[2 * k + side] * f->one_and_bias[1 + f->constant[k]];
    }
}

/* Deviation from the static bend, its covariance with what the bias parameters make of both, and the static bend's
 * modal states. `sensitivity` (n, 1 + c) is [x | V] from the static bend's, `gain` (c,) room. */
static void find_start(forecast *f, double *sensitivity, double *gain)
{
    int64_t n = f->n, width = f->width, c = width - 1;
    const double *static_bend = f->x + f->states * width;
    memcpy(sensitivity, f->x, (size_t)(n * width) * sizeof *sensitivity);
    add_scaled(sensitivity + f->static_state * width, static_bend, -1.0, width);
    for (int64_t i = 0; i < n; i++) {
        f->deviation[i] = dot(sensitivity + i * width, f->one_and_bias, width);
        memset(gain, 0, (size_t)c * sizeof *gain);
        for (int64_t k = 0; k < c; k++)
            add_scaled(gain, f->bias_covariance + k * c, sensitivity[i * width + 1 + k], c);
        for (int64_t j = 0; j < n; j++)
            f->covariance[i * n + j] = f->P[i * f->states + j] + dot(gain, sensitivity + j * width + 1, c);
    }
    double static_m = dot(static_bend, f->one_and_bias, width);
    for (int64_t i = 0; i < f->m; i++)
        f->static_modal[i] = f->modal_states[i] == f->static_state ? static_m : 0.0;
}

/* Values (2, count, 2) and covariances (2, count, 2, 2) at instant k. */
static void predict(forecast *f, int64_t k, double *values, double *spread)
{
    int64_t m = f->m, n = f->n, count = f->count;
    memset(f->rows, 0, (size_t)(OUTPUTS * n) * sizeof(double));
    for (int o = 0; o < OUTPUTS; o++)
        for (int64_t i = 0; i < m; i++)
            if (f->outputs[o * m + i] != 0.0)
                add_scaled(f->rows + o * n, f->powers + (i * count + k) * n, f->outputs[o * m + i], n);
    multiply(f->rows, f->covariance, OUTPUTS, n, n, f->projected);
    for (int pair = 0; pair < 2; pair++)
        for (int i = 0; i < 2; i++) {
            int64_t one = 2 * pair + i;
            values[(pair * count + k) * 2 + i] =
                dot(f->rows + one * n, f->deviation, n) + dot(f->outputs + one * m, f->static_modal, m);
            for (int j = i; j < 2; j++) {
                int64_t other = 2 * pair + j;
                double covariance = dot(f->projected + one * n, f->rows + other * n, n);
                for (int64_t a = 0; a < m; a++)
                    covariance += f->outputs[other * m + a] * f->outputs_noise[(one * m + a) * count + k];
                spread[((pair * count + k) * 2 + i) * 2 + j] = covariance;
                spread[((pair * count + k) * 2 + j) * 2 + i] = covariance;
            }
        }
    for (int64_t factor = 0; factor < f->factors; factor++) {
        int64_t at = f->rate[factor], column = f->constant[factor] * f->width;
        double rate = dot(f->powers + (at * count + k) * n, f->deviation, n) + f->static_modal[at];
        double more = f->bias_covariance[column] * squared(rate);
        spread[(count + k) * 4] += more;
        spread[(count + k) * 4 + 3] += more;
    }
}

static bool read_forecast(const indices_record *indices, const snapshot_record *snapshot, const array *powers_in,
                          const array *noise_in, const array *slope_in, forecast *f)
{
    bool good = true;
    f->modal_states = integers(indices->modal_states, 1, &good);
    f->q = integers(indices->q, 1, &good);
    f->static_state = indices->static_state;
    f->constant = integers(indices->constant, 1, &good);
    f->rate = integers(indices->rate, 1, &good);
    f->signs = reals(indices->signs, 2, &good);
    f->powers = reals(powers_in, 3, &good);
    f->noise = reals(noise_in, 3, &good);
    f->slope = reals(slope_in, 2, &good);
    f->x = reals(snapshot->state_and_sensitivity, 2, &good);
    f->one_and_bias = reals(snapshot->one_and_bias, 1, &good);
    f->P = reals(snapshot->covariance, 2, &good);
    f->bias_covariance = reals(snapshot->bias_parameter_covariance, 2, &good);
    if (!good)
        return false;
    f->factors = extent(indices->rate, 0);
    f->m = extent(powers_in, 0);
    f->count = extent(powers_in, 1);
    f->n = extent(powers_in, 2);
    f->states = extent(snapshot->covariance, 0);
    f->width = extent(snapshot->one_and_bias, 0);
    return f->n <= f->states && extent(snapshot->state_and_sensitivity, 0) == f->states + 1 &&
           extent(snapshot->state_and_sensitivity, 1) == f->width && extent(noise_in, 0) == f->m &&
           extent(noise_in, 2) == f->count && extent(slope_in, 1) == f->m &&
           extent(snapshot->bias_parameter_covariance, 0) == f->width - 1;
}

/* Modal coordinates and slope rates at all instants, (2, count, 2), and covariances, (2, count, 2, 2), of the modal
 * coordinates from the static bend. */
EXPORT int64_t forecast_run(const array *powers_in, const array *noise_in, const array *slope_in,
                            const indices_record *indices, const snapshot_record *snapshot, const array *values_out,
                            const array *spread_out)
{
    bool good = true;
    forecast f;
    double *values = reals(values_out, 3, &good), *spread = reals(spread_out, 4, &good);
    if (!good || !read_forecast(indices, snapshot, powers_in, noise_in, slope_in, &f) ||
        extent(values_out, 1) != f.count || extent(spread_out, 1) != f.count)
        return BAD_ARRAY;
    int64_t m = f.m, n = f.n, count = f.count;
    size_t room = (size_t)(OUTPUTS * m + m + n + n * n + 2 * OUTPUTS * n + OUTPUTS * m * count + (n + 1) * f.width);
    f.outputs = calloc(room, sizeof(double));
    if (!f.outputs)
        return NO_MEMORY;
    f.static_modal = f.outputs + OUTPUTS * m;
    f.deviation = f.static_modal + m;
    f.covariance = f.deviation + n;
    f.rows = f.covariance + n * n;
    f.projected = f.rows + OUTPUTS * n;
    f.outputs_noise = f.projected + OUTPUTS * n;
    find_outputs(&f);
    double *sensitivity = f.outputs_noise + OUTPUTS * m * count;
    find_start(&f, sensitivity, sensitivity + n * f.width);
    multiply(f.outputs, f.noise, OUTPUTS, m, m * count, f.outputs_noise);
    for (int64_t k = 0; k < count; k++)
        predict(&f, k, values, spread);
    free(f.outputs);
    return 0;
}

/* Sum of squares of some states (k,) over `count` steps of the ring of [x | V], (size, n, width), from `first` on. */
EXPORT int64_t estimate_squares(const array *ring_in, int64_t first, int64_t count, const array *states_in,
                                const array *one_and_bias_in, const array *squares_out)
{
    bool good = true;
    const double *ring = reals(ring_in, 3, &good), *one_and_bias = reals(one_and_bias_in, 1, &good);
    const int64_t *states = integers(states_in, 1, &good);
    double *squares = reals(squares_out, 1, &good);
    if (!good)
        return BAD_ARRAY;
    int64_t size = extent(ring_in, 0), n = extent(ring_in, 1), width = extent(ring_in, 2), k = extent(states_in, 0);
    if (size < 1 || first < 0 || extent(one_and_bias_in, 0) != width || extent(squares_out, 0) != k ||
        !all_within(states, k, 0, n))
        return BAD_ARRAY;
    for (int64_t i = 0; i < k; i++)
        squares[i] = 0.0;
    for (int64_t step = first; step < first + count; step++)
        for (int64_t i = 0; i < k; i++)
            squares[i] += squared(dot(ring + (step % size * n + states[i]) * width, one_and_bias, width));
    return 0;
}

/* Variance g^T P g over three states. */
static double variance(const double *by, const double *covariance)
{
    double total = 0.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            total += by[i] * by[j] * covariance[3 * i + j];
    return total;
}

/* Amplitude, phase and instantaneous frequency of one mode, each with its sigma, into (6,), by its deflection, rate and
 * load (3,) and their covariance. */
EXPORT int64_t estimate_oscillation(const array *state_in, const array *covariance_in, double static_m,
                                    double frequency_hz, double damping, double frequency_sigma_hz, const array *out_in)
{
    bool good = true;
    const double *state = reals(state_in, 1, &good), *covariance = reals(covariance_in, 2, &good);
    double *out = reals(out_in, 1, &good);
    if (!good || extent(state_in, 0) != 3 || extent(covariance_in, 0) != 3 ||
        extent(covariance_in, 1) != 3 || extent(out_in, 0) != 6)
        return BAD_ARRAY;
    double q = state[0] - static_m, v = state[1], load = state[2];
    double omega = 2.0 * PI * frequency_hz, s = v / omega, square = q * q + s * s, power = most(square, 1e-18);
    double pull = -2.0 * damping * omega * v - squared(omega) * q + load, rate = (v * s - q * pull / omega) / power;
    double by_state[3] = {q / sqrt(power), s / omega / sqrt(power), 0.0};
    double by_phase[3] = {s / power, -q / omega / power, 0.0};
    double by_rate[3] = {(-pull / omega + q * omega - 2.0 * q * rate) / power,
                         (2.0 * v / omega + 2.0 * damping * q - 2.0 * v / squared(omega) * rate) / power,
                         -q / omega / power};
    out[0] = sqrt(square);
    out[1] = sqrt(most(variance(by_state, covariance), 0.0));
    out[2] = atan2(-s, q);
    out[3] = sqrt(most(variance(by_phase, covariance), 0.0));
    out[4] = rate / (2.0 * PI);
    out[5] = sqrt(variance(by_rate, covariance) + squared(2.0 * PI * frequency_sigma_hz)) / (2.0 * PI);
    return 0;
}
