// A way home that was written by hand, judged by the shield. The robot is a cart on a table that slopes down from 0.6 towards its edge at 1: there the
// way home is too weak. Nobody tells the shield; it learns from attempts that fail.
//
//   cargo build --release --package shield-c && cargo xtask build
//   cc examples/c/controller.c -I shield-c/include -L target/release -lshield_runtime -Wl,-rpath,target/release -o controller
//   ./controller examples/c/controller.ron
#include <stdio.h>

#include "shield.h"

static const float SLOPE = 0.6f, EDGE = 1.0f;

// The task is to go right.
static float controller(float position) {
    (void)position;
    return 0.6f;
}

// The way home: half of what the motor can do, towards 0.
static int32_t go_home(void *context, const float *observation, size_t observation_len, float *action,
                       size_t action_len) {
    (void)context;
    if (observation_len != 1 || action_len != 1) return SHIELD_FAILED;
    action[0] = observation[0] > 0.0f ? -0.5f : 0.5f;
    return SHIELD_DONE;
}

// The robot: on the slope it slides, beyond the edge it lies on the floor.
static float execute(float position, float action) {
    if (position >= EDGE) return position;
    return position + 0.1f * action + (position > SLOPE ? 0.06f : 0.0f);
}

int main(int count, char **arguments) {
    const char *config = count > 1 ? arguments[1] : "examples/c/controller.ron";
    Shield *shield = shield_open_with_policy(config, go_home, NULL);
    if (!shield) {
        fprintf(stderr, "%s\n", shield_last_error());
        return 1;
    }
    float position = 0.0f;
    int aborts = 0, hard_resets = 0, of_late = 0;
    for (int step = 0; step < 6000; step++) {
        float action = controller(position);
        int verdict = shield_filter(shield, &position, 1, &action, 1);
        aborts += verdict == SHIELD_ABORT;
        position = execute(position, action);  // Whatever the verdict, this may be executed.
        if (verdict == SHIELD_FAILED || shield_observe(shield, &position, 1, position >= EDGE) == SHIELD_FAILED) {
            fprintf(stderr, "%s\n", shield_last_error());
            shield_close(shield);
            return 1;
        }
        if (shield_needs_hard_reset(shield)) {
            position = 0.0f;  // Somebody carries it back.
            shield_hard_reset_done(shield, &position, 1);
            hard_resets++;
            of_late += step >= 3000;
        }
    }
    printf("%d aborts, %d hard resets, %d of them in the second half\n", aborts, hard_resets, of_late);
    shield_close(shield);
    return 0;
}
