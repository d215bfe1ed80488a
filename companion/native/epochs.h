/* Epochs of measurements, as kernels/arrays.py has them, and the order of their rows. */
#ifndef SPANWISE_EPOCHS_H
#define SPANWISE_EPOCHS_H

#include "arrays.h"

enum { Z_LEFT = 0, M_LEFT = 2, Y_LEFT = 4, P_LEFT = 6, P_ROOT = 8, ROWS = 9 }; /* tracking/states.py */

typedef struct {
    const array *start_ns, *rows, *present, *vertical_mps2, *lateral_mps2, *slope_rate_gain, *lateral_gain, *load_g,
        *body_rate_radps, *earlier_roll_radps2, *earlier_load_g, *sensitivity, *aliasing_noise,
        *root_motion_variance, *root_vibrates, *root_covered;
} epochs_record;

#endif
