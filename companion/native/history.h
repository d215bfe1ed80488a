/* The filter's history, as kernels/arrays.py has it. */
#ifndef SPANWISE_HISTORY_H
#define SPANWISE_HISTORY_H

#include "epochs.h"

typedef struct {
    const array *state, *covariance, *transition, *transition_index, *row_count, *whitened_H, *whitened_innovation,
        *whitened_cross_cov, *static_m, *gate_excess, *innovation, *innovation_covariance, *lateral_gain;
} history_record;

/* Rings of `size` steps for n states and `width` columns. */
typedef struct {
    int64_t size, n, width, transitions;
    double *state, *covariance, *transition, *whitened_H, *whitened_innovation, *whitened_cross_cov, *static_m,
        *gate_excess, *innovation, *innovation_covariance, *lateral_gain;
    int64_t *transition_index, *row_count;
} history;

static inline bool has_shape(const array *a, int64_t first, int64_t second, int64_t third)
{
    return extent(a, 0) == first && (second < 0 || extent(a, 1) == second) && (third < 0 || extent(a, 2) == third);
}

static inline bool read_history(const history_record *record, history *h)
{
    bool good = true;
    *h = (history){
        .state = reals(record->state, 3, &good),
        .covariance = reals(record->covariance, 3, &good),
        .transition = reals(record->transition, 3, &good),
        .whitened_H = reals(record->whitened_H, 3, &good),
        .whitened_innovation = reals(record->whitened_innovation, 3, &good),
        .whitened_cross_cov = reals(record->whitened_cross_cov, 3, &good),
        .static_m = reals(record->static_m, 2, &good),
        .gate_excess = reals(record->gate_excess, 2, &good),
        .innovation = reals(record->innovation, 2, &good),
        .innovation_covariance = reals(record->innovation_covariance, 3, &good),
        .lateral_gain = reals(record->lateral_gain, 2, &good),
        .transition_index = integers(record->transition_index, 1, &good),
        .row_count = integers(record->row_count, 1, &good),
    };
    if (!good)
        return false;
    int64_t size = h->size = extent(record->state, 0), n = h->n = extent(record->state, 1);
    int64_t width = h->width = extent(record->state, 2);
    h->transitions = extent(record->transition, 0);
    return size > 0 && has_shape(record->covariance, size, n, n) &&
           has_shape(record->transition, h->transitions, n, n) &&
           has_shape(record->whitened_H, size, ROWS, n) && has_shape(record->whitened_innovation, size, ROWS, width) &&
           has_shape(record->whitened_cross_cov, size, ROWS, n) && has_shape(record->static_m, size, width, -1) &&
           has_shape(record->gate_excess, size, ROWS, -1) && has_shape(record->innovation, size, ROWS, -1) &&
           has_shape(record->innovation_covariance, size, ROWS, ROWS) &&
           has_shape(record->lateral_gain, size, 2, -1) && extent(record->transition_index, 0) == size &&
           extent(record->row_count, 0) == size;
}

#endif
