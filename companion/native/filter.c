/* One step of the Kalman filter with separated bias an epoch: see core/tracking/filter.py for its equations, and
 * core/kernels/arrays.py for its arrays and the gate. Absent rows cost nothing, and the zeros of the transition (nine
 * tenths of it) are skipped. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "history.h"
#include "linear.h"

#define LOAD_FACTOR_TIME_S 1.0  /* kernels/arrays.py has the reasons of all of these */
#define GATE_SIGMAS 5.0
#define LOAD_VARIANCE_RATIO 0.7
#define MAX_NOISE_INFLATION 1e6
#define MAX_STEP_NIS 200.0
#define STRUCK_SIGMAS 3.0
#define MOST_TILT_RAD 0.5

/* Rows of `linearised`: what they give, by tip where there are two. From MODES on those of each rank of modes, lowest
 * first: lifts, lift rates as the step begins, lift accelerations; the slope factors' regressors follow. */
enum { SLOPES = 0, SLOPE_RATES = 2, ROLL_RATE = 4, ROLL_ACCELERATION, MODES, EACH_RANK = 6, MAX_RANKS = 16 };

typedef struct {
    double step_s, trim_m, bend_per_g_m, root_z_variance, root_y_variance;
    int64_t trim_column, bend_column;
    const array *sensor_variance, *lateral_bias_state, *roll_misalignment_column, *vertical_bias_state,
        *bias_projection;
    int64_t common_bias_column;
    const array *slope_factor_rows, *slope_factor_columns, *regressor_rows, *regressor_columns, *regressor_sources,
        *regressor_signs, *lever_m, *foreshortening_pm;
    int64_t foreshortening_column, further_foreshortening_column;
    const array *height_column;
} constants_record;

typedef struct {
    const array *transition, *static_input, *row, *col, *value;
    int64_t transition_index;
    const array *H, *Q, *cross_cov, *process_noise_in_rows, *load_noise, *load_cross_cov, *load_noise_in_rows,
        *linearisation_rows;
    double aliasing_variance;
    int64_t moments_beside_gyro;
    const array *lift_acceleration_share, *lift_acceleration_covariance, *motion_covariance;
} model_record;

typedef struct {
    const array *state_and_sensitivity, *covariance, *information, *one_and_bias, *nis_sums, *bias_covariance,
        *teachable;
} state_record;

/* Derivatives of a tip's lateral force by the body's roll rate and acceleration, and by each rank's lift, lift rate as
 * the step begins, and acceleration. */
typedef struct {
    double roll_rate, roll_acceleration, lift[MAX_RANKS], rate[MAX_RANKS], acceleration[MAX_RANKS];
} force_derivatives;

/* Lateral force that a moving tip feels beyond the rigid one and its tilt, m/s^2: itself, and what the slope row has of
 * it. */
typedef struct {
    double force;
    force_derivatives by;
    double per_foreshortening, per_further_foreshortening; /* by its relative errors */
    double rest;          /* what a linear form of these leaves of the slope row */
    double gain;          /* what a unit of force adds to the row */
    double variance;      /* by accelerations that the measured sums do not tell apart */
    double blow_variance; /* the same by a blow, whose shares are not a gust's */
    double per_measured, per_other; /* the force's derivatives by the measured acceleration of this tip and the other */
} moving_tip;

/* The same force as it is expected without the measured acceleration, for the row that measures that. */
typedef struct {
    double force;
    force_derivatives by;
} expected_force;

/* What each rank of modes has in a tip's acceleration beyond the expected one, and in the other tip's. */
typedef struct {
    const double *own, *other, *covariance;
} rank_shares;

/* Everything of a run as plain pointers, and scratch arrays of one step. `used` are the numbers of the used rows,
 * `position` each row's place among them (-1: absent); the scratch matrices hold the used rows. */
typedef struct {
    const constants_record *constants;
    const double *sensor_variance, *bias_projection, *regressor_signs, *lever_m, *foreshortening_pm;
    const int64_t *height_column; /* 0 where a tip's height is certain */
    const int64_t *lateral_bias_state, *roll_misalignment_column, *vertical_bias_state, *slope_factor_rows,
        *slope_factor_columns, *regressor_rows, *regressor_columns, *regressor_sources;
    int64_t slope_factors, regressors;

    const model_record *model;
    const double *static_input, *value, *model_H, *Q, *cross_cov, *process_noise, *load_noise, *load_cross_cov,
        *load_noise_in_rows, *linearisation_rows, *lift_acceleration_share, *lift_acceleration_covariance,
        *motion_covariance;
    const int64_t *row, *col;
    int64_t entries, linearised_rows;

    const double *rows, *vertical_mps2, *lateral_mps2, *slope_rate_gain, *lateral_gain, *load_g, *body_rate_radps,
        *earlier_roll_radps2, *earlier_load_g, *row_sensitivity, *aliasing_noise, *root_motion_variance;
    const uint8_t *present, *root_vibrates;

    double *x, *covariance, *information, *one_and_bias, *nis_sums; /* x: [x | V], static bend in the last row */
    const double *bias_covariance;
    const int64_t *teachable;
    int64_t teachable_count;
    history h;

    int64_t ranks;
    moving_tip tip[2];
    expected_force expected[2];
    double beyond[2]; /* see beyond_expected */
    int64_t count, used[ROWS], position[ROWS];
    double innovation[ROWS], predicted_variance[ROWS], whitened[ROWS], row_innovation[ROWS], S[ROWS][ROWS];
    double gate_square[ROWS]; /* square of the gate, in variances of the whitened row */
    double *state, *linearised, *H, *HP, *next_state, *next_covariance, *factor; /* the last: entries of a row */
    double *sensitivity;
    int64_t *entry;
} run;

/* Static bend over the coming step and its sensitivities, in the last row of [x | V]. */
static void set_static_bend(run *f, double load_g)
{
    const constants_record *c = f->constants;
    double *bend = f->x + f->h.n * f->h.width;
    bend[0] = c->trim_m + c->bend_per_g_m * load_g;
    if (c->trim_column)
        bend[c->trim_column] = 1.0;
    if (c->bend_column) /* smoothed, because the noise of the load is in the innovations too */
        bend[c->bend_column] += c->step_s / LOAD_FACTOR_TIME_S * (load_g - bend[c->bend_column]);
}

/* State, covariance and transition at the start of the step into the history. */
static void store_prior(run *f, int64_t slot)
{
    int64_t n = f->h.n, width = f->h.width;
    memcpy(f->h.state + slot * n * width, f->x, (size_t)(n * width) * sizeof(double));
    memcpy(f->h.covariance + slot * n * n, f->covariance, (size_t)(n * n) * sizeof(double));
    memcpy(f->h.static_m + slot * width, f->x + n * width, (size_t)width * sizeof(double));
    f->h.transition_index[slot] = f->model->transition_index;
}

/* State at the estimated bias parameters, static bend last, and the linearisation rows of it. */
static void linearise_state(run *f)
{
    int64_t n = f->h.n + 1;
    for (int64_t i = 0; i < n; i++)
        f->state[i] = dot(f->x + i * f->h.width, f->one_and_bias, f->h.width);
    for (int64_t i = 0; i < f->linearised_rows; i++)
        f->linearised[i] = dot(f->linearisation_rows + i * n, f->state, n);
}

/* Measured rows; first moments only where they add to a gyro. */
static void select_rows(run *f, const uint8_t *present)
{
    f->count = 0;
    for (int row = 0; row < ROWS; row++) {
        bool moment = M_LEFT <= row && row < Y_LEFT;
        f->position[row] = -1;
        if (!present[row] || (moment && !f->model->moments_beside_gyro && present[P_LEFT + row - M_LEFT]))
            continue;
        f->used[f->count] = row;
        f->position[row] = f->count++;
    }
}

/* Square of the body's turn about its x and y axes: a tip feels it times its lift, downward. */
static double turn_squared(const run *f, int64_t k)
{
    return squared(f->linearised[ROLL_RATE]) + squared(f->body_rate_radps[3 * k + 1]);
}

/* Lift of a tip by all ranks. */
static double lift_of_tip(const run *f, int side)
{
    double lift = 0.0;
    for (int64_t a = 0; a < f->ranks; a++)
        lift += f->linearised[MODES + a * EACH_RANK + side];
    return lift;
}

/* What the measured sum of all ranks' lift accelerations of a tip is beyond the expected one. */
static double beyond_expected(const run *f, int64_t k, int side)
{
    const double *expected = f->linearised + MODES + side + 4;
    double slope = f->linearised[SLOPES + side];
    double tilted = (0.5 * f->vertical_mps2[2 * k + side] * slope + f->lateral_mps2[2 * k + side]) * slope;
    double beyond = f->lever_m[side] * f->linearised[ROLL_ACCELERATION] - f->rows[k * ROWS + Z_LEFT + side] - tilted +
                    turn_squared(f, k) * lift_of_tip(f, side);
    for (int64_t b = 0; b < f->ranks; b++)
        beyond -= expected[b * EACH_RANK];
    return beyond;
}

/* Shares of each rank in what both tips show beyond the expected, of this tip's and of the other's, and the covariance
 * of the ranks' accelerations that this leaves open. */
static rank_shares find_shares(const run *f, int side)
{
    static const double none[MAX_RANKS] = {0.0};
    int64_t ranks = f->ranks;
    const double *shares = f->lift_acceleration_share, *covariances = f->lift_acceleration_covariance;
    if (f->position[Z_LEFT + side] < 0)
        return (rank_shares){none, none, covariances + 2 * ranks * ranks};
    if (f->position[Z_LEFT + 1 - side] < 0)
        return (rank_shares){shares, none, covariances + ranks * ranks};
    return (rank_shares){shares + ranks, shares + 2 * ranks, covariances};
}

/* Mean lift accelerations and rates over step k by rank, as expected and with shares of what is beyond that; and the
 * acceleration's first moment, by which lift and force change together. */
static void find_lift_rates(const run *f, int64_t k, int side, rank_shares share, double *accelerations, double *rates,
                            double *inside)
{
    const double *start = f->linearised + MODES + side + 2, *moment = f->rows + k * ROWS + M_LEFT;
    double own = f->beyond[side], other = f->beyond[1 - side], step_s = f->constants->step_s;
    for (int64_t b = 0; b < f->ranks; b++) {
        accelerations[b] = start[b * EACH_RANK + 2] + share.own[b] * own + share.other[b] * other;
        inside[b] = -step_s * (share.own[b] * moment[side] + share.other[b] * moment[1 - side]);
        rates[b] = start[b * EACH_RANK] + 0.5 * step_s * accelerations[b] - inside[b];
    }
}

/* How much higher than in the airframe file a tip's sensor is estimated to sit. */
static double height_of_tip(const run *f, int side)
{
    return f->height_column[side] ? f->one_and_bias[f->height_column[side]] : 0.0;
}

/* Estimated over believed foreshortening. */
static double foreshortening_factor(const run *f, int64_t column)
{
    return column ? 1.0 + f->one_and_bias[column] : 1.0;
}

/* Lift accelerations as the derivatives have them, by rank: those found, with the root's roll acceleration of some
 * epochs before. The state's, by which the tips' measured ones are found, is noisy, and its error is in the rows. */
static void find_instruments(const run *f, int64_t k, int side, rank_shares share, const double *accelerations,
                             double *instruments)
{
    double change = f->earlier_roll_radps2[k] - f->linearised[ROLL_ACCELERATION];
    for (int64_t b = 0; b < f->ranks; b++) {
        double lever_m = share.own[b] * f->lever_m[side] + share.other[b] * f->lever_m[1 - side];
        instruments[b] = accelerations[b] + lever_m * change;
    }
}

/* Sum of a tip's derivatives times what they are by, as predicted. */
static double linear_form(const run *f, int side, const force_derivatives *by)
{
    const double *lift = f->linearised + MODES + side;
    double sum = by->roll_rate * f->linearised[ROLL_RATE] + by->roll_acceleration * f->linearised[ROLL_ACCELERATION];
    for (int64_t a = 0; a < f->ranks; a++, lift += EACH_RANK)
        sum += by->lift[a] * lift[0] + by->rate[a] * lift[2] + by->acceleration[a] * lift[4];
    return sum;
}

/* Add a tip's derivatives, times a gain, to a row of H (n + 1,). */
static void add_derivatives(const run *f, int side, const force_derivatives *by, double gain, double *out)
{
    const double *rows = f->linearisation_rows;
    int64_t n = f->h.n + 1;
    add_scaled(out, rows + ROLL_RATE * n, gain * by->roll_rate, n);
    add_scaled(out, rows + ROLL_ACCELERATION * n, gain * by->roll_acceleration, n);
    for (int64_t a = 0; a < f->ranks; a++) {
        const double *lift = rows + (MODES + a * EACH_RANK + side) * n;
        add_scaled(out, lift, gain * by->lift[a], n);
        add_scaled(out, lift + 2 * n, gain * by->rate[a], n);
        add_scaled(out, lift + 4 * n, gain * by->acceleration[a], n);
    }
}

/* Lateral force of a moving tip (find_moving_tip) by the predicted state alone. */
static expected_force find_expected_force(const run *f, int64_t k, int side)
{
    const double *lifts = f->linearised + MODES + side, *rates = lifts + 2, *accelerations = lifts + 4;
    const double *kappa = f->foreshortening_pm + side * f->ranks * f->ranks;
    double lowest = foreshortening_factor(f, f->constants->foreshortening_column);
    double further = foreshortening_factor(f, f->constants->further_foreshortening_column);
    double p = f->linearised[ROLL_RATE], p_dot = f->linearised[ROLL_ACCELERATION];
    double turning = -f->body_rate_radps[3 * k + 1] * f->body_rate_radps[3 * k + 2];
    double raised = height_of_tip(f, side); /* the sensor's place in the turning body, beside the wing's lift */
    expected_force of = {.force = 0.0};
    for (int64_t i = 0; i < f->ranks; i++) {
        int64_t a = i * EACH_RANK;
        raised += lifts[a];
        of.force += 2.0 * p * rates[a];
        of.by.roll_rate += 2.0 * rates[a];
        of.by.lift[i] += f->earlier_roll_radps2[k] + turning; /* an earlier p', as in find_moving_tip */
        of.by.rate[i] += 2.0 * p;
        for (int64_t j = 0; j < f->ranks; j++) {
            int64_t b = j * EACH_RANK;
            double foreshortening = (i || j ? further : lowest) * kappa[i * f->ranks + j];
            of.force -= foreshortening * (lifts[a] * accelerations[b] + rates[a] * rates[b]);
            of.by.lift[i] -= foreshortening * accelerations[b];
            of.by.rate[i] -= 2.0 * foreshortening * rates[b];
            of.by.acceleration[j] -= foreshortening * lifts[a];
        }
    }
    of.force += (p_dot + turning) * raised;
    if (fabs(f->linearised[SLOPES + side]) > MOST_TILT_RAD)
        return (expected_force){.force = of.force};
    of.by.roll_acceleration = raised;
    return of;
}

/* Motion of a tip in the turning body: Coriolis', Euler's and centripetal force by its lift w, and that of the bent
 * wing's tip, whose foreshortening is half of kappa w^2. */
static moving_tip find_moving_tip(const run *f, int64_t k, int side)
{
    const double *lifts = f->linearised + MODES + side;
    const double *expected_of_other = f->linearised + MODES + 1 - side + 4;
    int64_t squares = f->ranks * f->ranks;
    const double *kappa = f->foreshortening_pm + side * squares;
    double lowest = foreshortening_factor(f, f->constants->foreshortening_column);
    double further = foreshortening_factor(f, f->constants->further_foreshortening_column);
    rank_shares share = find_shares(f, side);
    double p = f->linearised[ROLL_RATE], p_dot = f->linearised[ROLL_ACCELERATION];
    double slope = f->linearised[SLOPES + side], sign = 1.0 - 2.0 * side;
    double turning = -f->body_rate_radps[3 * k + 1] * f->body_rate_radps[3 * k + 2], across = p_dot + turning;
    double accelerations[MAX_RANKS], instruments[MAX_RANKS], rates[MAX_RANKS], inside[MAX_RANKS];
    double by_rates[MAX_RANKS], by_lifts[MAX_RANKS], by_foreshortening = 0.0;
    double step_s = f->constants->step_s, quarter = 0.25 * step_s * step_s, by_sum = 0.0;
    find_lift_rates(f, k, side, share, accelerations, rates, inside);
    find_instruments(f, k, side, share, accelerations, instruments);
    moving_tip tip = {.force = 0.0};
    for (int64_t a = 0; a < f->ranks; a++) {
        double lift = lifts[a * EACH_RANK], by_lift = 0.0, by_instrument = 0.0, by_rate = 0.0, by_moment = 0.0;
        /* a lift that makes its product with the acceleration, beside the rates', the change of w w' over the step */
        double mean_lift = lift + quarter * (accelerations[a] - 2.0 * inside[a] / step_s);
        for (int64_t b = 0; b < f->ranks; b++) {
            double believed = kappa[a * f->ranks + b], factor = a || b ? further : lowest;
            double foreshortening = factor * believed, by_instruments = instruments[b] * mean_lift;
            *(a || b ? &tip.per_further_foreshortening : &tip.per_foreshortening) -=
                believed * (by_instruments + (rates[b] + inside[b]) * rates[a]);
            by_lift += foreshortening * accelerations[b];
            by_instrument += foreshortening * instruments[b];
            by_rate += foreshortening * rates[b];
            by_moment += foreshortening * inside[b];
            tip.by.acceleration[b] -= foreshortening * lift;
        }
        by_rates[a] = by_rate;
        by_lifts[a] = by_lift;
        /* an earlier p': the state's goes with the error of p' w, and teaches false lifts */
        tip.by.lift[a] = f->earlier_roll_radps2[k] + turning - by_instrument;
        tip.by.rate[a] = 2.0 * p - 2.0 * by_rate - by_moment;
        tip.by.roll_rate += 2.0 * rates[a];
        tip.by.roll_acceleration += lift;
        by_foreshortening -= by_lift * mean_lift + (by_rate + by_moment) * rates[a];
        tip.force += across * lift + 2.0 * p * rates[a];
    }
    double height = height_of_tip(f, side); /* the sensor's place in the turning body, beside the wing's lift */
    tip.force += across * height;
    tip.by.roll_acceleration += height;
    /* half a step of each is in its rate */
    for (int64_t b = 0; b < f->ranks; b++) {
        tip.by.acceleration[b] -= step_s * by_rates[b];
        by_sum += share.own[b] * tip.by.acceleration[b];
    }
    for (int64_t b = 0; b < f->ranks; b++) {
        const double *left_open = share.covariance + b * f->ranks;
        const double *whole = f->lift_acceleration_covariance + 2 * squares;
        for (int64_t c = 0; c < f->ranks; c++) {
            double product = (tip.by.acceleration[b] - by_sum) * (tip.by.acceleration[c] - by_sum);
            tip.variance += product * left_open[c];
            tip.blow_variance += product * whole[b * f->ranks + c];
        }
    }
    for (int64_t b = 0; b < f->ranks; b++) {
        tip.by.acceleration[b] -= 2.0 * quarter * by_lifts[b]; /* expected: a blow has more */
        tip.per_measured += share.own[b] * tip.by.acceleration[b];
        tip.per_other += share.other[b] * tip.by.acceleration[b];
    }
    double by_other = 0.0;
    for (int64_t b = 0; b < f->ranks; b++) {
        tip.by.acceleration[b] -= tip.per_measured;
        by_other -= tip.per_other * expected_of_other[b * EACH_RANK];
    }
    /* the roll lifts the tips as well */
    tip.by.roll_acceleration += tip.per_measured * f->lever_m[side] + tip.per_other * f->lever_m[1 - side];
    /* the measured acceleration has what the tilt shows of all this */
    by_foreshortening -= tip.per_measured * sign * slope * (tip.force + by_foreshortening);
    tip.force += by_foreshortening;
    /* the row is the arc tangent of all lateral force over the vertical one */
    double read = f->rows[k * ROWS + Y_LEFT + side], gain = f->lateral_gain[2 * k + side];
    double all = tip.force + sign * f->lateral_mps2[2 * k + side]; /* by 1 / cos(slope), once it is turned */
    double lean = tan(read) - gain * (tip.force + 0.5 * all * squared(slope));
    tip.gain = gain / (1.0 + squared(lean));
    tip.rest = atan(lean) - read + tip.gain * (linear_form(f, side, &tip.by) + by_other);
    return tip;
}

/* Add a moving tip's lateral force, divided by the vertical one, to a slope row (n + 1,). */
static void add_moving_tip(const run *f, int side, double *out)
{
    const moving_tip *tip = &f->tip[side];
    int64_t n = f->h.n + 1;
    add_derivatives(f, side, &tip->by, tip->gain, out);
    for (int64_t a = 0; a < f->ranks; a++)
        add_scaled(out, f->linearisation_rows + (MODES + a * EACH_RANK + 1 - side + 4) * n, -tip->gain * tip->per_other,
                   n);
}

/* Add a lifted tip's centripetal force, downward, to a vertical row (n + 1,). */
static void add_turning_tip(const run *f, int64_t k, int side, double *out)
{
    const double *rows = f->linearisation_rows;
    int64_t n = f->h.n + 1;
    for (int64_t a = 0; a < f->ranks; a++)
        add_scaled(out, rows + (MODES + a * EACH_RANK + side) * n, turn_squared(f, k), n);
    add_scaled(out, rows + ROLL_RATE * n, 2.0 * f->linearised[ROLL_RATE] * lift_of_tip(f, side), n);
}

/* Add what a tilted tip shows of its vertical and of its expected lateral force to a vertical row (n + 1,). */
static void add_tilted_force(const run *f, int64_t k, int side, double *out)
{
    const expected_force *of = &f->expected[side];
    double sign = 1.0 - 2.0 * side, slope = f->linearised[SLOPES + side];
    double turned = f->vertical_mps2[2 * k + side] * slope + f->lateral_mps2[2 * k + side] + sign * of->force;
    int64_t n = f->h.n + 1;
    add_scaled(out, f->linearisation_rows + (SLOPES + side) * n, -turned, n);
    add_derivatives(f, side, &of->by, -sign * slope, out);
}

/* H of the used rows, with the tip's tilt linearised at the predicted state: through the tilt gravity shows slow
 * bending. */
static void linearise_rows(run *f, int64_t k)
{
    int64_t n = f->h.n + 1;
    for (int64_t r = 0; r < f->count; r++)
        memcpy(f->H + r * n, f->model_H + f->used[r] * n, (size_t)n * sizeof(double));
    for (int side = 0; side < 2; side++) {
        int64_t r = f->position[Z_LEFT + side], bias = f->lateral_bias_state[side];
        double vertical = f->vertical_mps2[2 * k + side];
        if (r >= 0) {
            add_tilted_force(f, k, side, f->H + r * n);
            add_turning_tip(f, k, side, f->H + r * n);
        }
        r = f->position[Y_LEFT + side];
        if (r >= 0) {
            if (bias >= 0)
                f->H[r * n + bias] = f->lateral_gain[2 * k + side];
            add_moving_tip(f, side, f->H + r * n);
            for (int tip = 0; tip < 2; tip++)
                if (f->vertical_bias_state[tip] >= 0) /* the measured accelerations have it */
                    f->H[r * n + f->vertical_bias_state[tip]] +=
                        f->tip[side].gain * (tip == side ? f->tip[side].per_measured : f->tip[side].per_other);
        }
        if (r >= 0 && f->constants->common_bias_column) /* the slope seen is lateral over vertical force */
            for (int tip = 0; tip < 2; tip++)
                f->H[r * n + f->vertical_bias_state[tip]] -=
                    f->linearised[SLOPES + side] / vertical * f->bias_projection[2 * side + tip];
    }
}

/* Columns of a row (n,) whose entries are not zero, and these by a sign, into `entry` and `factor`; their count. */
static int64_t find_entries(run *f, const double *row, double sign, int64_t n)
{
    int64_t count = 0;
    for (int64_t i = 0; i < n; i++)
        if (row[i] != 0.0) {
            f->entry[count] = i;
            f->factor[count++] = sign * row[i];
        }
    return count;
}

/* Errors of the predicted rows (ROWS,) by the measured load factor, and in slope rows by the state's roll acceleration,
 * taken against their means of some epochs before: they are in the innovations too. */
static void find_shared_errors(const run *f, int64_t k, double *errors)
{
    double roll = f->linearised[ROLL_ACCELERATION] - f->earlier_roll_radps2[k];
    double bend = f->constants->bend_per_g_m * (f->load_g[k] - f->earlier_load_g[k]);
    int64_t n = f->h.n;
    memset(errors, 0, ROWS * sizeof *errors);
    for (int64_t r = 0; r < f->count; r++)
        errors[f->used[r]] = f->H[r * (n + 1) + n] * bend;
    for (int side = 0; side < 2; side++)
        errors[Y_LEFT + side] += f->tip[side].gain * f->tip[side].by.roll_acceleration * roll;
}

/* Replace the measurement by its prediction in the sensitivities that contain it, and that by one without errors which
 * the innovation shares: their squares would be learned from. */
static void regress_on_prediction(run *f, int64_t k, double *out)
{
    int64_t width = f->h.width;
    double errors[ROWS];
    find_shared_errors(f, k, errors);
    for (int row = 0; row < ROWS; row++) {
        int64_t at = f->position[row];
        f->row_innovation[row] = at >= 0 ? dot(out + at * width, f->one_and_bias, width) : 0.0;
    }
    for (int64_t j = 0; j < f->regressors; j++) {
        int64_t at = f->position[f->regressor_rows[j]], source = f->regressor_sources[j];
        if (at >= 0 && f->position[source] >= 0)
            out[at * width + f->regressor_columns[j]] +=
                f->regressor_signs[j] * (f->row_innovation[source] + errors[source]);
    }
    for (int side = 0; side < 2; side++) { /* the vertical force by which a tilt shows is measured too */
        int64_t at = f->position[Z_LEFT + side], roll = f->roll_misalignment_column[side];
        if (at < 0)
            continue;
        const double *tilt = f->linearisation_rows + (SLOPES + side) * (f->h.n + 1);
        double excess = f->linearised[SLOPES + side] * f->row_innovation[Z_LEFT + side], residual = out[at * width];
        int64_t count = find_entries(f, tilt, -excess, f->h.n + 1);
        add_selected(out + at * width, width, f->x, f->entry, f->factor, count);
        out[at * width] = residual;
        if (roll)
            out[at * width + roll] -= (1.0 - 2.0 * side) * excess;
    }
}

/* Add to a slope row's sensitivity (width,) what errors of the measured acceleration do to the moving tip's force, and
 * the vertical scale to that force over the vertical one, of which the Jacobian has the lateral force whole. */
static void add_acceleration_errors(const run *f, int64_t k, int side, double *out)
{
    const moving_tip *tip = &f->tip[side];
    int64_t parameters = f->h.width - 1;
    const double *sensitivity = f->row_sensitivity + (k * ROWS + Z_LEFT) * parameters;
    add_scaled(out + 1, sensitivity + side * parameters, -tip->gain * tip->per_measured, parameters);
    add_scaled(out + 1, sensitivity + (1 - side) * parameters, -tip->gain * tip->per_other, parameters);
    for (int64_t j = 0; j < f->regressors; j++)
        if (f->regressor_rows[j] == Z_LEFT + side)
            out[f->regressor_columns[j]] -= tip->gain * tip->force;
}

/* Sensitivity of a slope row (width,) to a relative error of the foreshortening; its estimate is in the row. */
static void add_foreshortening(const run *f, int64_t column, double sensitivity, double *out)
{
    if (!column)
        return;
    out[column] += sensitivity;
    out[0] -= sensitivity * f->one_and_bias[column];
}

/* Innovation e of the used rows and its sensitivity D to the bias parameters, into (count, width). */
static void find_innovation(run *f, int64_t k, double *out)
{
    int64_t n = f->h.n + 1, width = f->h.width;
    for (int64_t r = 0; r < f->count; r++) {
        const double *sensitivity = f->row_sensitivity + (k * ROWS + f->used[r]) * (width - 1);
        out[r * width] = f->rows[k * ROWS + f->used[r]];
        for (int64_t j = 1; j < width; j++)
            out[r * width + j] = -sensitivity[j - 1];
    }
    for (int side = 0; side < 2; side++) {
        double slope = f->linearised[SLOPES + side], rate = f->linearised[SLOPE_RATES + side];
        double vertical = f->vertical_mps2[2 * k + side];
        int64_t r = f->position[Z_LEFT + side], roll = f->roll_misalignment_column[side];
        if (r >= 0) {
            out[r * width] += 2.0 * squared(f->linearised[ROLL_RATE]) * lift_of_tip(f, side);
            out[r * width] -= 0.5 * vertical * slope * slope +
                              (1.0 - 2.0 * side) * slope * linear_form(f, side, &f->expected[side].by);
            if (roll) /* of the lateral force the Jacobian has the rigid one: here is the rest */
                out[r * width + roll] += (1.0 - 2.0 * side) * vertical * slope + f->expected[side].force;
        }
        r = f->position[Y_LEFT + side];
        if (r >= 0) {
            if (f->height_column[side]) /* the force has it at the estimate */
                out[r * width] -= out[r * width + f->height_column[side]] * height_of_tip(f, side);
            out[r * width] += f->slope_rate_gain[2 * k + side] * rate;
            out[r * width] += f->tip[side].rest;
            const moving_tip *tip = &f->tip[side];
            add_foreshortening(f, f->constants->foreshortening_column, -tip->gain * tip->per_foreshortening,
                               out + r * width);
            add_foreshortening(f, f->constants->further_foreshortening_column,
                               -tip->gain * tip->per_further_foreshortening, out + r * width);
            if (f->constants->common_bias_column) /* of the tilt alone: the tip's force is over the measured one */
                out[r * width + f->constants->common_bias_column] += slope / vertical;
            add_acceleration_errors(f, k, side, out + r * width);
        }
    }
    for (int64_t j = 0; j < f->slope_factors; j++) {
        int64_t r = f->position[f->slope_factor_rows[j]];
        if (r >= 0)
            out[r * width + f->slope_factor_columns[j]] = f->linearised[MODES + EACH_RANK * f->ranks + j];
    }
    for (int64_t r = 0; r < f->count; r++) {
        int64_t count = find_entries(f, f->H + r * n, -1.0, n);
        add_selected(out + r * width, width, f->x, f->entry, f->factor, count);
    }
    regress_on_prediction(f, k, out);
}

/* H P. */
static void project_covariance(run *f)
{
    int64_t n = f->h.n;
    memset(f->HP, 0, (size_t)(f->count * n) * sizeof(double));
    for (int64_t r = 0; r < f->count; r++) {
        int64_t count = find_entries(f, f->H + r * (n + 1), 1.0, n);
        add_selected(f->HP + r * n, n, f->covariance, f->entry, f->factor, count);
    }
}

/* S = H P H^T + inflated process noise + sensor noise of the used rows; lower half. */
static void find_innovation_covariance(run *f, int64_t k, double noise_inflation)
{
    int64_t n = f->h.n;
    const double *motion = f->root_motion_variance + 3 * k, *gain = f->lateral_gain + 2 * k;
    for (int64_t r = 0; r < f->count; r++) {
        int64_t row = f->used[r];
        for (int64_t q = 0; q <= r; q++)
            f->S[r][q] = f->process_noise[row * ROWS + f->used[q]] +
                         (noise_inflation - 1.0) * f->load_noise_in_rows[row * ROWS + f->used[q]] +
                         dot(f->HP + r * n, f->H + q * (n + 1), n);
        bool lateral = Y_LEFT <= row && row < P_LEFT;
        f->S[r][r] += f->sensor_variance[row] * (lateral ? squared(gain[row - Y_LEFT]) : 1.0);
        if (lateral) /* what it shares with other rows is left out: linearised at a wrong state that did harm */
            f->S[r][r] += (f->tip[row - Y_LEFT].variance +
                           (noise_inflation - 1.0) * f->tip[row - Y_LEFT].blow_variance +
                           squared(f->tip[row - Y_LEFT].per_measured + f->tip[row - Y_LEFT].per_other) * motion[0]) *
                          squared(gain[row - Y_LEFT]);
        if (row < M_LEFT)
            f->S[r][r] += noise_inflation * f->model->aliasing_variance * f->aliasing_noise[2 * k + row];
        if (row == P_ROOT)
            f->S[r][r] += motion[2];
    }
    for (int side = 0; side < 2; side++)
        for (int other = 0; other <= side; other++) {
            int64_t r = f->position[Z_LEFT + side], q = f->position[Z_LEFT + other];
            if (r >= 0 && q >= 0)
                f->S[r][q] += f->constants->root_z_variance + motion[0];
            r = f->position[Y_LEFT + side];
            q = f->position[Y_LEFT + other];
            if (r >= 0 && q >= 0)
                f->S[r][q] += (f->constants->root_y_variance + motion[1]) * gain[side] * gain[other];
        }
}

/* Innovations at the estimated bias parameters, with their covariance; both are noted in the history. */
static void sum_innovation(run *f, int64_t k, int64_t slot)
{
    double *innovation = f->h.innovation + slot * ROWS, *covariance = f->h.innovation_covariance + slot * ROWS * ROWS;
    const double *rows = f->h.whitened_innovation + slot * ROWS * f->h.width;
    memset(innovation, 0, ROWS * sizeof *innovation);
    memcpy(f->h.lateral_gain + 2 * slot, f->lateral_gain + 2 * k, 2 * sizeof(double));
    for (int row = 0; row < ROWS; row++)
        memset(covariance + row * ROWS, 0, (size_t)(row + 1) * sizeof *covariance);
    for (int64_t r = 0; r < f->count; r++) {
        int64_t row = f->used[r];
        innovation[row] = f->innovation[r] = dot(rows + r * f->h.width, f->one_and_bias, f->h.width);
        f->predicted_variance[r] = f->S[r][r];
        for (int64_t q = 0; q <= r; q++)
            covariance[row * ROWS + f->used[q]] = f->S[r][q];
    }
}

/* Cholesky factor L of S in place, diagonal inverted, and the whitened innovation; false without one. `robust`: the
 * pivot p of each row with an innovation e beyond the gate is raised to |e| sqrt(p) over it (Huber's weight). */
static bool factorise(run *f, bool robust)
{
    for (int64_t r = 0; r < f->count; r++) {
        double innovation = f->innovation[r];
        for (int64_t q = 0; q < r; q++) {
            double total = f->S[r][q];
            for (int64_t j = 0; j < q; j++)
                total -= f->S[r][j] * f->S[q][j];
            f->S[r][q] = total * f->S[q][q];
            innovation -= f->S[r][q] * f->whitened[q];
        }
        double pivot = f->S[r][r];
        for (int64_t j = 0; j < r; j++)
            pivot -= f->S[r][j] * f->S[r][j];
        if (!(0.0 < pivot && pivot < INFINITY))
            return false;
        if (robust)
            pivot = most(pivot, fabs(innovation) * sqrt(pivot / f->gate_square[r]));
        f->S[r][r] = 1.0 / sqrt(pivot);
        f->whitened[r] = innovation * f->S[r][r];
    }
    return true;
}

/* Variance of the root's vertical motion that its samples do not resolve and that loads the wing. */
static double struck_variance(const run *f, int64_t k)
{
    return f->root_vibrates[k] ? 0.0 : f->root_motion_variance[3 * k];
}

/* Variance of a vertical row by motion of the root that is not resolved, and by the load that it makes. */
static double unresolved_variance(const run *f, int64_t k)
{
    return (1.0 + LOAD_VARIANCE_RATIO) * struck_variance(f, k);
}

/* Variance of a whitened row by the bias parameters that a flight may teach, beside its own of 1; `rows` as predicted:
 * [e | D] (count, width). */
static double variance_by_parameters(run *f, const double *rows, int64_t r)
{
    double weights[ROWS], variance = 0.0;
    weights[r] = f->S[r][r]; /* row r of L^-1 */
    for (int64_t q = r - 1; q >= 0; q--) {
        double sum = 0.0;
        for (int64_t j = q + 1; j <= r; j++)
            sum += weights[j] * f->S[j][q];
        weights[q] = -sum * f->S[q][q];
    }
    memset(f->sensitivity, 0, (size_t)f->h.width * sizeof *f->sensitivity);
    add_combination(f->sensitivity, f->h.width, rows, f->h.width, weights, 1, r + 1);
    for (int64_t i = 0; i < f->teachable_count; i++)
        for (int64_t j = 0; j < f->teachable_count; j++) {
            int64_t a = f->teachable[i], b = f->teachable[j];
            variance += f->sensitivity[1 + a] * f->bias_covariance[a * (f->h.width - 1) + b] * f->sensitivity[1 + b];
        }
    return most(variance, 0.0);
}

/* Accumulate the NIS and note what teaches nothing; whether a row lies beyond the gate, which is as wide as the bias
 * parameters are uncertain. */
static bool gate(run *f, int64_t k, const double *rows, double *excess)
{
    double square_sum = 0.0, fade = 1.0 - f->constants->step_s;
    bool gated = false;
    memset(excess, 0, ROWS * sizeof *excess);
    for (int64_t r = 0; r < f->count; r++) {
        int64_t row = f->used[r];
        double square = squared(f->whitened[r]), by_root = 0.0;
        f->gate_square[r] = squared(GATE_SIGMAS);
        if (square > f->gate_square[r])
            f->gate_square[r] *= 1.0 + variance_by_parameters(f, rows, r);
        if (square > f->gate_square[r]) {
            gated = true;
            double beyond = most(fabs(f->innovation[r]) - sqrt(f->gate_square[r] * f->predicted_variance[r]), 0.0);
            excess[row] = f->innovation[r] < 0.0 ? -beyond : beyond;
        }
        if (row < M_LEFT)
            by_root = unresolved_variance(f, k);
        else if (row == P_ROOT)
            by_root = f->root_motion_variance[3 * k + 2];
        if (by_root > 0.5 * f->predicted_variance[r])
            excess[row] = f->innovation[r];
        square_sum += square;
    }
    f->nis_sums[0] = fade * f->nis_sums[0] + (gated ? least(square_sum, MAX_STEP_NIS) : square_sum);
    f->nis_sums[1] = fade * f->nis_sums[1] + (double)f->count;
    return gated;
}

/* Factor on the process noise that adds at least e^2 - g^2 S to the variance S of each vertical row beyond the gate g:
 * a large innovation e then lies at about one sigma. */
static double inflate_process_noise(const run *f, double before)
{
    double inflation = before;
    for (int64_t r = 0; r < f->count; r++) {
        int64_t row = f->used[r];
        if (row >= M_LEFT || !(squared(f->whitened[r]) > f->gate_square[r]))
            continue;
        double uncovered = squared(f->innovation[r]) - f->gate_square[r] * f->predicted_variance[r];
        inflation = most(inflation, before + uncovered / f->load_noise_in_rows[row * ROWS + row]);
    }
    return least(inflation, MAX_NOISE_INFLATION);
}

/* C^T = H P A^T + H1 Q, with inflated process noise, into (count, n). */
static void find_cross_covariance(const run *f, double noise_inflation, double *out)
{
    int64_t n = f->h.n;
    for (int64_t r = 0; r < f->count; r++) {
        const double *noise = f->cross_cov + f->used[r] * n, *HP = f->HP + r * n;
        const double *by_load = f->load_cross_cov + f->used[r] * n;
        double *row = out + r * n;
        for (int64_t i = 0; i < n; i++)
            row[i] = noise[i] + (noise_inflation - 1.0) * by_load[i];
        for (int64_t e = 0; e < f->entries; e++)
            row[f->row[e]] += f->value[e] * HP[f->col[e]];
    }
}

/* L^-1 times the rows (count, width), in place. */
static void whiten(const run *f, double *rows, int64_t width)
{
    double factors[ROWS];
    for (int64_t r = 0; r < f->count; r++) {
        for (int64_t q = 0; q < r; q++)
            factors[q] = -f->S[r][q];
        add_combination(rows + r * width, width, rows, width, factors, 1, r);
        for (int64_t j = 0; j < width; j++)
            rows[r * width + j] *= f->S[r][r];
    }
}

/* Add A rows, (n, width), to `out`. */
static void add_transition_product(const run *f, const double *rows, int64_t width, double *out)
{
    int64_t first = 0, next = 0;
    for (; first < f->entries; first = next) {
        while (next < f->entries && f->row[next] == f->row[first])
            next++;
        add_selected(out + f->row[first] * width, width, rows, f->col + first, f->value + first, next - first);
    }
}

/* [x | V] after the step: A x + b u + C S^-1 e, likewise for every column. */
static void propagate_state(run *f, const double *cross_cov, const double *innovation)
{
    int64_t n = f->h.n, width = f->h.width;
    memset(f->next_state, 0, (size_t)(n * width) * sizeof(double));
    add_transition_product(f, f->x, width, f->next_state);
    for (int64_t i = 0; i < n; i++) {
        double *next = f->next_state + i * width;
        if (f->static_input[i] != 0.0)
            add_scaled(next, f->x + n * width, f->static_input[i], width);
        add_combination(next, width, innovation, width, cross_cov + i, n, f->count);
    }
    memcpy(f->x, f->next_state, (size_t)(n * width) * sizeof(double));
}

/* P = A P A^T + inflated Q - C S^-1 C^T: the lower half, mirrored. */
static void propagate_covariance(run *f, double noise_inflation, const double *cross_cov)
{
    int64_t n = f->h.n;
    double *P = f->covariance, *product = f->next_covariance;
    memset(product, 0, (size_t)(n * n) * sizeof(double));
    add_transition_product(f, P, n, product);
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < i; j++) {
            double kept = product[i * n + j];
            product[i * n + j] = product[j * n + i];
            product[j * n + i] = kept;
        }
    for (int64_t i = 0; i < n * n; i++)
        P[i] = f->Q[i] + (noise_inflation - 1.0) * f->load_noise[i];
    add_transition_product(f, product, n, P);
    double factors[ROWS];
    for (int64_t i = 0; i < n; i++) {
        for (int64_t r = 0; r < f->count; r++)
            factors[r] = -cross_cov[r * n + i];
        add_combination(P + i * n, i + 1, cross_cov, n, factors, 1, f->count);
    }
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < i; j++)
            P[j * n + i] = P[i * n + j];
}

/* Whether the root is struck: it does not resolve its motion, and neither that nor a gust explains what the tips show.
 * The static bend of such a load factor is none, and the state is wrong by it. */
static bool is_struck(const run *f, int64_t k)
{
    double by_root = unresolved_variance(f, k);
    for (int side = 0; side < 2; side++) {
        int64_t r = f->position[Z_LEFT + side];
        if (r < 0 || by_root <= 0.5 * f->predicted_variance[r] ||
            squared(f->innovation[r]) < squared(STRUCK_SIGMAS) * f->predicted_variance[r])
            return false;
    }
    return true;
}

/* Predict, gate, update and propagate through epoch k; false where the numbers have run away. */
static bool step(run *f, int64_t k, int64_t slot)
{
    int64_t n = f->h.n, width = f->h.width;
    double *whitened_H = f->h.whitened_H + slot * ROWS * n;
    double *innovation = f->h.whitened_innovation + slot * ROWS * width;
    double *cross_cov = f->h.whitened_cross_cov + slot * ROWS * n;
    set_static_bend(f, f->load_g[k]);
    store_prior(f, slot);
    linearise_state(f);
    select_rows(f, f->present + k * ROWS);
    f->h.row_count[slot] = f->count;
    for (int side = 0; side < 2; side++)
        f->beyond[side] = beyond_expected(f, k, side);
    for (int side = 0; side < 2; side++) {
        f->expected[side] = find_expected_force(f, k, side);
        f->tip[side] = find_moving_tip(f, k, side);
    }
    linearise_rows(f, k);
    find_innovation(f, k, innovation);
    project_covariance(f);
    double by_load = f->load_noise_in_rows[Z_LEFT * ROWS + Z_LEFT];
    double shaken = LOAD_VARIANCE_RATIO * struck_variance(f, k) / by_load;
    double noise_inflation = least(1.0 + shaken, MAX_NOISE_INFLATION);
    find_innovation_covariance(f, k, noise_inflation);
    sum_innovation(f, k, slot);
    if (!factorise(f, false))
        return false;
    bool gated = gate(f, k, innovation, f->h.gate_excess + slot * ROWS);
    if (gated) {
        noise_inflation = inflate_process_noise(f, noise_inflation);
        find_innovation_covariance(f, k, noise_inflation);
        if (!factorise(f, true))
            return false;
    }
    find_cross_covariance(f, noise_inflation, cross_cov);
    for (int64_t r = 0; r < f->count; r++)
        memcpy(whitened_H + r * n, f->H + r * (n + 1), (size_t)n * sizeof(double));
    whiten(f, whitened_H, n);
    whiten(f, innovation, width);
    whiten(f, cross_cov, n);
    for (int64_t i = 0; i < width; i++)
        add_combination(f->information + i * width, width, innovation, width, innovation + i, width,
                        gated ? 0 : f->count);
    propagate_state(f, cross_cov, innovation);
    propagate_covariance(f, noise_inflation, cross_cov);
    if (is_struck(f, k))
        add_scaled(f->covariance, f->motion_covariance, 1.0, n * n);
    return true;
}

static bool read_constants(const constants_record *record, run *f)
{
    bool good = true;
    f->constants = record;
    f->sensor_variance = reals(record->sensor_variance, 1, &good);
    f->lateral_bias_state = integers(record->lateral_bias_state, 1, &good);
    f->roll_misalignment_column = integers(record->roll_misalignment_column, 1, &good);
    f->height_column = integers(record->height_column, 1, &good);
    f->vertical_bias_state = integers(record->vertical_bias_state, 1, &good);
    f->bias_projection = reals(record->bias_projection, 2, &good);
    f->slope_factor_rows = integers(record->slope_factor_rows, 1, &good);
    f->slope_factor_columns = integers(record->slope_factor_columns, 1, &good);
    f->regressor_rows = integers(record->regressor_rows, 1, &good);
    f->regressor_columns = integers(record->regressor_columns, 1, &good);
    f->regressor_sources = integers(record->regressor_sources, 1, &good);
    f->regressor_signs = reals(record->regressor_signs, 1, &good);
    f->lever_m = reals(record->lever_m, 1, &good);
    f->foreshortening_pm = reals(record->foreshortening_pm, 3, &good);
    f->ranks = extent(record->foreshortening_pm, 1);
    f->slope_factors = extent(record->slope_factor_rows, 0);
    f->regressors = extent(record->regressor_rows, 0);
    return good && extent(record->sensor_variance, 0) == ROWS && extent(record->bias_projection, 0) == 2 &&
           extent(record->lever_m, 0) == 2 && has_shape(record->foreshortening_pm, 2, f->ranks, f->ranks) &&
           0 < f->ranks && f->ranks <= MAX_RANKS;
}

static bool read_model(const model_record *record, run *f)
{
    bool good = true;
    int64_t n = f->h.n;
    f->model = record;
    f->static_input = reals(record->static_input, 1, &good);
    f->row = integers(record->row, 1, &good);
    f->col = integers(record->col, 1, &good);
    f->value = reals(record->value, 1, &good);
    f->model_H = reals(record->H, 2, &good);
    f->Q = reals(record->Q, 2, &good);
    f->cross_cov = reals(record->cross_cov, 2, &good);
    f->process_noise = reals(record->process_noise_in_rows, 2, &good);
    f->load_noise = reals(record->load_noise, 2, &good);
    f->load_cross_cov = reals(record->load_cross_cov, 2, &good);
    f->load_noise_in_rows = reals(record->load_noise_in_rows, 2, &good);
    f->linearisation_rows = reals(record->linearisation_rows, 2, &good);
    f->lift_acceleration_share = reals(record->lift_acceleration_share, 2, &good);
    f->lift_acceleration_covariance = reals(record->lift_acceleration_covariance, 3, &good);
    f->motion_covariance = reals(record->motion_covariance, 2, &good);
    f->entries = extent(record->value, 0);
    f->linearised_rows = extent(record->linearisation_rows, 0);
    return good && extent(record->static_input, 0) == n && has_shape(record->H, ROWS, n + 1, -1) &&
           has_shape(record->Q, n, n, -1) && has_shape(record->cross_cov, ROWS, n, -1) &&
           has_shape(record->load_noise, n, n, -1) && has_shape(record->load_cross_cov, ROWS, n, -1) &&
           has_shape(record->load_noise_in_rows, ROWS, ROWS, -1) &&
           has_shape(record->process_noise_in_rows, ROWS, ROWS, -1) && extent(record->row, 0) == f->entries &&
           extent(record->linearisation_rows, 1) == n + 1 &&
           f->linearised_rows == MODES + EACH_RANK * f->ranks + f->slope_factors &&
           has_shape(record->lift_acceleration_share, 3, f->ranks, -1) &&
           has_shape(record->lift_acceleration_covariance, 3, f->ranks, f->ranks) &&
           has_shape(record->motion_covariance, n, n, -1) && record->transition_index < f->h.transitions;
}

static bool read_epochs(const epochs_record *record, int64_t last, run *f)
{
    bool good = true;
    f->rows = reals(record->rows, 2, &good);
    f->present = truths(record->present, 2, &good);
    f->vertical_mps2 = reals(record->vertical_mps2, 2, &good);
    f->lateral_mps2 = reals(record->lateral_mps2, 2, &good);
    f->slope_rate_gain = reals(record->slope_rate_gain, 2, &good);
    f->lateral_gain = reals(record->lateral_gain, 2, &good);
    f->load_g = reals(record->load_g, 1, &good);
    f->body_rate_radps = reals(record->body_rate_radps, 2, &good);
    f->earlier_roll_radps2 = reals(record->earlier_roll_radps2, 1, &good);
    f->earlier_load_g = reals(record->earlier_load_g, 1, &good);
    f->row_sensitivity = reals(record->sensitivity, 3, &good);
    f->aliasing_noise = reals(record->aliasing_noise, 2, &good);
    f->root_motion_variance = reals(record->root_motion_variance, 2, &good);
    f->root_vibrates = truths(record->root_vibrates, 1, &good);
    return good && extent(record->rows, 0) >= last && extent(record->present, 0) >= last &&
           extent(record->vertical_mps2, 0) >= last && extent(record->lateral_mps2, 0) >= last &&
           extent(record->slope_rate_gain, 0) >= last && extent(record->lateral_gain, 0) >= last &&
           extent(record->load_g, 0) >= last && extent(record->aliasing_noise, 0) >= last &&
           extent(record->root_vibrates, 0) >= last &&
           extent(record->body_rate_radps, 0) >= last && extent(record->body_rate_radps, 1) == 3 &&
           extent(record->earlier_roll_radps2, 0) >= last && extent(record->earlier_load_g, 0) >= last &&
           extent(record->root_motion_variance, 0) >= last &&
           extent(record->sensitivity, 0) >= last && extent(record->sensitivity, 2) == f->h.width - 1;
}

static bool read_state(const state_record *record, run *f)
{
    bool good = true;
    int64_t n = f->h.n, width = f->h.width;
    f->x = reals(record->state_and_sensitivity, 2, &good);
    f->covariance = reals(record->covariance, 2, &good);
    f->information = reals(record->information, 2, &good);
    f->one_and_bias = reals(record->one_and_bias, 1, &good);
    f->nis_sums = reals(record->nis_sums, 1, &good);
    f->bias_covariance = reals(record->bias_covariance, 2, &good);
    f->teachable = integers(record->teachable, 1, &good);
    f->teachable_count = extent(record->teachable, 0);
    return good && has_shape(record->bias_covariance, width - 1, width - 1, -1) &&
           has_shape(record->state_and_sensitivity, n + 1, width, -1) &&
           has_shape(record->covariance, n, n, -1) && has_shape(record->information, width, width, -1) &&
           extent(record->one_and_bias, 0) == width;
}

/* Filter the epochs first:last in place, the first of which is step `steps`; 0 where the innovation covariance is not
 * positive definite or not finite: the filter has run away. */
EXPORT int64_t filter_epochs(const constants_record *constants, const model_record *model,
                             const epochs_record *epochs, const state_record *state, const history_record *past,
                             int64_t first, int64_t last, int64_t steps)
{
    run f;
    if (!read_history(past, &f.h) || !read_constants(constants, &f) || !read_model(model, &f) || first < 0 ||
        !read_epochs(epochs, last, &f) || !read_state(state, &f))
        return BAD_ARRAY;
    int64_t n = f.h.n, width = f.h.width;
    size_t room = (size_t)(n + 1 + f.linearised_rows + ROWS * (n + 1) + ROWS * n + n * width + n * n + n + 1 + width);
    f.state = malloc(room * sizeof(double));
    f.entry = malloc((size_t)(n + 1) * sizeof *f.entry);
    if (!f.state || !f.entry) {
        free(f.state);
        free(f.entry);
        return NO_MEMORY;
    }
    f.linearised = f.state + n + 1;
    f.H = f.linearised + f.linearised_rows;
    f.HP = f.H + ROWS * (n + 1);
    f.next_state = f.HP + ROWS * n;
    f.next_covariance = f.next_state + n * width;
    f.factor = f.next_covariance + n * n;
    f.sensitivity = f.factor + n + 1;
    bool finite = true;
    for (int64_t k = first; k < last && finite; k++)
        finite = step(&f, k, (steps + k - first) % f.h.size);
    free(f.state);
    free(f.entry);
    return finite;
}

/* Run the smoother's adjoint recursion (core/tracking/smoother.py) back over `count` steps to `first`: l (n, width)
 * at it and at the step after it, W (n, n) at it. */
EXPORT int64_t smoother_backward(const history_record *past, int64_t first, int64_t count, const array *adjoint_out,
                                 const array *next_out, const array *information_out)
{
    bool good = true;
    history h;
    double *adjoint = reals(adjoint_out, 2, &good), *next = reals(next_out, 2, &good);
    double *W = reals(information_out, 2, &good);
    if (!good || !read_history(past, &h) || !has_shape(adjoint_out, h.n, h.width, -1) ||
        !has_shape(next_out, h.n, h.width, -1) || !has_shape(information_out, h.n, h.n, -1) || first < 0)
        return BAD_ARRAY;
    int64_t n = h.n, width = h.width;
    double *closed = malloc((size_t)(2 * n * n) * sizeof *closed);
    if (!closed)
        return NO_MEMORY;
    double *product = closed + n * n;
    memset(adjoint, 0, (size_t)(n * width) * sizeof *adjoint);
    memset(next, 0, (size_t)(n * width) * sizeof *next);
    memset(W, 0, (size_t)(n * n) * sizeof *W);
    for (int64_t back = 1; back <= count; back++) {
        int64_t slot = (first + count - back) % h.size, used = h.row_count[slot];
        const double *H = h.whitened_H + slot * ROWS * n, *cross_cov = h.whitened_cross_cov + slot * ROWS * n;
        const double *innovation = h.whitened_innovation + slot * ROWS * width;
        memcpy(closed, h.transition + h.transition_index[slot] * n * n, (size_t)(n * n) * sizeof *closed);
        for (int64_t i = 0; i < n; i++)
            for (int64_t r = 0; r < used; r++)
                add_scaled(closed + i * n, H + r * n, -cross_cov[r * n + i], n);
        memcpy(next, adjoint, (size_t)(n * width) * sizeof *next);
        multiply(W, closed, n, n, n, product);
        memset(adjoint, 0, (size_t)(n * width) * sizeof *adjoint);
        memset(W, 0, (size_t)(n * n) * sizeof *W);
        for (int64_t k = 0; k < n; k++)
            for (int64_t i = 0; i < n; i++) {
                add_scaled(adjoint + i * width, next + k * width, closed[k * n + i], width);
                add_scaled(W + i * n, product + k * n, closed[k * n + i], n);
            }
        for (int64_t r = 0; r < used; r++)
            for (int64_t i = 0; i < n; i++) {
                add_scaled(adjoint + i * width, innovation + r * width, H[r * n + i], width);
                add_scaled(W + i * n, H + r * n, H[r * n + i], n);
            }
    }
    free(closed);
    return 0;
}
