// Runs a five-bar in MuJoCo and prints where its tool was, and the time that the steps took. `yieldwall study plant` gives it
// its scenes; hil-tests/peers/mujoco builds it.
//
// A scene is read from the standard input: lines of a word and numbers, in this order.
//   cycles N             cycles of 1 ms that are timed and printed
//   warm N               cycles run before, from the same start, to warm caches and clock rate
//   repeats N            how often the timed cycles are run
//   gains KP KD          controller of each driven joint, in N m/rad and N m s/rad
//   torque A B           torque of the motors beside the controller's, in N m
//   hand K B             spring and damper of the hand on the tool, in N/m and N s/m
//   push X Y             force on the tool beside the hand's, in N
//   arc X Y R            centre and radius of the arc along which the hand aims, in m
//   tremor A F           of that radius: amplitude in m, frequency in Hz
//   swing P A F          angle on the arc, P + A (1 - cos(2 pi F t)), in rad and Hz
//   plan N               then N lines, one a cycle: wanted angles of both driven joints in rad, wanted rates in rad/s
//   model N              then N bytes of MJCF: joints driven, passive of one chain, then of the other; a site at each chain's
//                        end, the first of which is the tool; a key frame, which is the start
//
// Printed: `version V`, `on_core_ns T` of one repeat, then a line for each cycle: tool x, y in m at its end, and how far the ends of
// the two chains are apart, in m. The timed stretch holds the controller, mj_step with the hand among its passive forces, and
// the copying of joint angles, and nothing else.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <mujoco/mujoco.h>

enum { JOINTS = 4 };

static double gains[2], torque[2], hand[2], push[2], arc[3], tremor[2], swing[3];

static void fail(const char *what) {
    fprintf(stderr, "error: %s\n", what);
    exit(1);
}

static void missing(const char *word) {
    fprintf(stderr, "error: the scene has no line `%s` with its numbers where one is due\n", word);
    exit(1);
}

// One line: its word and `count` numbers.
static void expect(const char *word, int count, double *numbers) {
    char found[32];
    if (scanf("%31s", found) != 1 || strcmp(found, word)) {
        missing(word);
    }
    for (int i = 0; i < count; i++) {
        if (scanf("%lf", numbers + i) != 1) {
            missing(word);
        }
    }
}

static int expect_count(const char *word) {
    double count;
    expect(word, 1, &count);
    if (!(count >= 0 && count <= 1e8)) {
        missing(word);
    }
    return (int)count;
}

// The hand's force and the push, as torques of the first chain's joints. Called wherever mj_step asks for passive forces.
static void passive(const mjModel *model, mjData *data) {
    (void)model;
    double force[2] = {push[0], push[1]};
    if (hand[0] > 0 || hand[1] > 0) {
        double turn = 2 * M_PI * swing[2] * data->time, beat = 2 * M_PI * tremor[1] * data->time;
        double angle = swing[0] + swing[1] * (1 - cos(turn)), rate = swing[1] * 2 * M_PI * swing[2] * sin(turn);
        double radius = arc[2] + tremor[0] * sin(beat), grow = tremor[0] * 2 * M_PI * tremor[1] * cos(beat);
        double c = cos(angle), s = sin(angle);
        double target[2] = {arc[0] + radius * c, arc[1] + radius * s};
        double speed[2] = {grow * c - radius * rate * s, grow * s + radius * rate * c};
        const double *tool = data->site_xpos;
        double velocity[2] = {0, 0};
        for (int joint = 0; joint < 2; joint++) {
            const double *anchor = data->xanchor + 3 * joint;
            velocity[0] -= data->qvel[joint] * (tool[1] - anchor[1]);
            velocity[1] += data->qvel[joint] * (tool[0] - anchor[0]);
        }
        for (int axis = 0; axis < 2; axis++) {
            force[axis] += hand[0] * (target[axis] - tool[axis]) + hand[1] * (speed[axis] - velocity[axis]);
        }
    }
    for (int joint = 0; joint < 2; joint++) {
        const double *anchor = data->xanchor + 3 * joint, *tool = data->site_xpos;
        data->qfrc_passive[joint] += (tool[0] - anchor[0]) * force[1] - (tool[1] - anchor[1]) * force[0];
    }
}

static double on_core_ns(void) {
    struct timespec time;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return 1e9 * (double)time.tv_sec + (double)time.tv_nsec;
}

// Cycles from the start; angles of the four joints at the end of each.
static void run(const mjModel *model, mjData *data, int cycles, const double *plan, double *angles) {
    int steps = (int)lround(1e-3 / model->opt.timestep);
    for (int cycle = 0; cycle < cycles; cycle++) {
        const double *wanted = plan + 4 * cycle;
        for (int motor = 0; motor < 2; motor++) {
            int joint = 2 * motor;
            data->qfrc_applied[joint] = torque[motor] + gains[0] * (wanted[motor] - data->qpos[joint]) +
                                        gains[1] * (wanted[motor + 2] - data->qvel[joint]);
        }
        for (int step = 0; step < steps; step++) {
            mj_step(model, data);
        }
        memcpy(angles + JOINTS * cycle, data->qpos, JOINTS * sizeof *angles);
    }
}

int main(void) {
    int cycles = expect_count("cycles"), warm = expect_count("warm"), repeats = expect_count("repeats");
    expect("gains", 2, gains);
    expect("torque", 2, torque);
    expect("hand", 2, hand);
    expect("push", 2, push);
    expect("arc", 3, arc);
    expect("tremor", 2, tremor);
    expect("swing", 3, swing);
    int planned = expect_count("plan");
    if (planned < cycles || planned < warm || repeats < 1) {
        fail("the plan is shorter than the run, or the run is not repeated");
    }
    double *plan = malloc(sizeof *plan * 4 * (size_t)planned + 1);
    for (int i = 0; i < 4 * planned; i++) {
        if (scanf("%lf", plan + i) != 1) {
            fail("the plan has too few numbers");
        }
    }
    int size = expect_count("model");
    char *text = malloc((size_t)size + 1);
    if (getchar() != '\n' || fread(text, 1, (size_t)size, stdin) != (size_t)size) {
        fail("the model is shorter than it says");
    }
    text[size] = 0;

    char message[1024] = "";
    mjSpec *spec = mj_parseXMLString(text, NULL, message, sizeof message);
    mjModel *model = spec ? mj_compile(spec, NULL) : NULL;
    if (!model) {
        fail(spec ? mjs_getError(spec) : message);
    }
    if (model->nv != JOINTS || model->nsite != 2 || model->nkey != 1) {
        fail("the model is not a five-bar with four joints, two sites and a key frame");
    }
    mjData *data = mj_makeData(model);
    double *angles = malloc(sizeof *angles * JOINTS * (size_t)(cycles > warm ? cycles : warm) + 1);
    mjcb_passive = passive;

    mj_resetDataKeyframe(model, data, 0);
    run(model, data, warm, plan, angles);
    double before = on_core_ns();
    for (int repeat = 0; repeat < repeats; repeat++) {
        mj_resetDataKeyframe(model, data, 0);
        run(model, data, cycles, plan, angles);
    }
    double after = on_core_ns();

    printf("version %s\non_core_ns %.0f\n", mj_versionString(), (after - before) / repeats);
    for (int cycle = 0; cycle < cycles; cycle++) {
        memcpy(data->qpos, angles + JOINTS * cycle, JOINTS * sizeof *angles);
        mj_kinematics(model, data);
        const double *tool = data->site_xpos, *other = data->site_xpos + 3;
        printf("%.17g %.17g %.17g\n", tool[0], tool[1], hypot(tool[0] - other[0], tool[1] - other[1]));
    }
    return 0;
}
