/* What a campaign keeps of a recording, in one pass over it. */
#ifndef DASHPOT_MEASURES_H
#define DASHPOT_MEASURES_H

#ifdef __cplusplus
extern "C" {
#endif

/* Rows of the result, each of n joints; NaN where there is nothing to take it from. */
enum {
    DP_MEASURE_ERROR_RMS,
    DP_MEASURE_ERROR_MAX,
    DP_MEASURE_ERROR_MEAN,
    DP_MEASURE_ERROR_STD,
    DP_MEASURE_ERROR_AFTER,
    DP_MEASURE_STOP_TIME,
    DP_MEASURE_STOP_ANGLE,
    DP_MEASURE_TRAVEL,
    DP_MEASURE_DRIFT_SPEED,
    DP_MEASURE_SPEED_PEAK,
    DP_MEASURE_TORQUE_PEAK,
    DP_MEASURE_TORQUE_STEP, /* largest change of the command from one powered tick to the next [N m] */
    DP_MEASURE_TORQUE_NOISE,
    DP_MEASURE_VIBRATION,
    DP_MEASURE_EARLIER, /* vibration in the window before the last */
    DP_NMEASURE
};

/* Two second-order sections: b0 b1 b2 a1 a2 each. */
typedef struct {
    double section[2][5];
} dp_highpass;

typedef struct {
    const double *reference, *angle, *speed, *command, *in_effect, *sample; /* (ticks, joints) */
    const unsigned char *powered;                                          /* (ticks), or 0: always */
    int ticks, joints;
    int begin; /* first tick of the motion */
    int event; /* tick of the release or first fault; ticks: there is none */
    double period;
    double slowed, at_rest; /* share of its speed at the event, and speed [rad/s], below which a joint is slow */
    int stays, last;        /* ticks that it must stay slow, and over which drift is taken */
    const dp_highpass *noise, *vibration; /* of command and sample; 0: sampled too slowly to tell */
    int window;                           /* ticks of the vibration's window; 0: too few */
} dp_measured;

void dp_measure(const dp_measured *m, double *out);

#ifdef __cplusplus
}
#endif

#endif
