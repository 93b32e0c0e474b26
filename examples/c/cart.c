// A controller written by hand, shielded. The robot is a cart on a table: whoever pushes it beyond the edge has to carry it back.
//
//   cargo build --release --package shield-c && cargo xtask build
//   cc examples/c/cart.c -I shield-c/include -L target/release -lshield_runtime -Wl,-rpath,target/release -o cart
//   ./cart examples/c/cart.ron
#include <stdio.h>

#include "shield.h"

static const float EDGE = 1.0f;

// The controller wants to go right.
static float controller(float position) {
    (void)position;
    return 0.6f;
}

// The robot: beyond the edge it lies on the floor and does not move any more.
static float execute(float position, float action) {
    return position < EDGE ? position + 0.1f * action : position;
}

int main(int count, char **arguments) {
    Shield *shield = shield_open(count > 1 ? arguments[1] : "examples/c/cart.ron");
    if (!shield) {
        fprintf(stderr, "%s\n", shield_last_error());
        return 1;
    }
    float position = 0.0f;
    int aborts = 0, hard_resets = 0, last_hard_reset = 0;
    for (int step = 0; step < 6000; step++) {
        float action = controller(position);
        int verdict = shield_filter(shield, &position, 1, &action, 1);
        aborts += verdict == SHIELD_ABORT;
        position = execute(position, action);  // Whatever the verdict, this may be executed.
        if (verdict == SHIELD_FAILED || shield_observe(shield, &position, 1, 0) == SHIELD_FAILED) {
            fprintf(stderr, "%s\n", shield_last_error());
            shield_close(shield);
            return 1;
        }
        if (shield_needs_hard_reset(shield)) {
            position = 0.0f;  // Somebody carries it back.
            shield_hard_reset_done(shield, &position, 1);
            hard_resets++;
            last_hard_reset = step;
        }
    }
    printf("%d aborts, %d hard resets, the last one in step %d\n", aborts, hard_resets, last_hard_reset);
    shield_close(shield);
    return 0;
}
