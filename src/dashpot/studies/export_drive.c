/* Runs an exported controller through a script, on the host and on a bare target (dashpot.studies.export_cases).
 *
 * Compiled with NAME and UPPER (the export's prefix), HEADER, and SUPERVISED where a supervisor goes along.
 * Every tick of the script is action, joint, value, x[4], in[7 n] and, supervised, ages [2 n]; every tick of the
 * result is out[n], status, supervisor's state. All doubles.
 */
#include HEADER

#define PASTE(a, b) a##_##b
#define JOIN(a, b) PASTE(a, b)
#define F(name) JOIN(NAME, name)
#define N JOIN(UPPER, JOINTS)
#define NIN JOIN(UPPER, NIN)

enum { NONE, MODE, LOOP, WARM, PRESET, RESET, ISSUE, STOP, SUPERVISOR_RESET };

static F(controller) c;
#ifdef SUPERVISED
static F(supervisor) s;
enum { WIDTH = 7 + 9 * N };
#else
enum { WIDTH = 7 + 7 * N };
#endif

int start(void);
int drive(const double *script, double *result, int ticks);

/* Resets; what the export says about itself: 0 where this build is bit-equal. */
int start(void)
{
#ifdef SUPERVISED
    const int checked = F(supervisor_check)(&s, &c) | F(check)(&c);
    F(supervisor_init)(&s);
    return checked;
#else
    return F(check)(&c);
#endif
}

int drive(const double *script, double *result, int ticks)
{
    for (int tick = 0; tick < ticks; tick++, script += WIDTH, result += N + 2) {
        const int action = (int)script[0], joint = (int)script[1];
        const double value = script[2], *x = script + 3, *in = script + 7;
        int status;
        switch (action) {
        case MODE: F(set_mode)(&c, joint, (int)value); break;
        case LOOP: F(set_position_loop)(&c, joint, (int)value); break;
        case WARM: F(warm_start)(&c, joint, value); break;
        case PRESET: F(preset)(&c, joint, x, value); break;
        case RESET: F(reset)(&c); break;
#ifdef SUPERVISED
        case STOP: F(supervisor_stop)(&s, (int)value); break;
        case SUPERVISOR_RESET: F(supervisor_reset)(&s, &c); break;
#endif
        default: break;
        }
#ifdef SUPERVISED
        int torque_age[N], encoder_age[N];
        for (int j = 0; j < N; j++) {
            torque_age[j] = (int)in[NIN * N + j];
            encoder_age[j] = (int)in[NIN * N + N + j];
        }
        status = F(supervise)(&s, &c, in, torque_age, encoder_age, result);
        result[N + 1] = s.state + 4 * s.apply_brake;
#else
        status = action == ISSUE ? F(issue)(&c, in, result) : F(step)(&c, in, result);
        result[N + 1] = 0.0;
#endif
        result[N] = status;
    }
    return 0;
}

#ifdef HOST
#include <stdio.h>
#include <stdlib.h>

int main(void)
{
    enum { AT_ONCE = 1000 };
    double *script = malloc(sizeof(double) * WIDTH * AT_ONCE), *result = malloc(sizeof(double) * (N + 2) * AT_ONCE);
    size_t ticks;
    if (!script || !result || start())
        return 1;
    while ((ticks = fread(script, sizeof(double) * WIDTH, AT_ONCE, stdin)) > 0) {
        drive(script, result, (int)ticks);
        if (fwrite(result, sizeof(double) * (N + 2), ticks, stdout) != ticks)
            return 1;
    }
    free(script);
    free(result);
    return 0;
}
#else
#include <stddef.h>

/* What a freestanding compiler may call, under the names of C and of the ARM run-time interface. */
#define BYTES(suffix) \
    void __aeabi_memclr##suffix(void *to, size_t size); \
    void __aeabi_memcpy##suffix(void *to, const void *from, size_t size); \
    void __aeabi_memclr##suffix(void *to, size_t size) { memset(to, 0, size); } \
    void __aeabi_memcpy##suffix(void *to, const void *from, size_t size) { memcpy(to, from, size); }

void *memset(void *to, int value, size_t size);
void *memcpy(void *restrict to, const void *restrict from, size_t size);

void *memset(void *to, int value, size_t size)
{
    volatile unsigned char *p = to;
    while (size--)
        *p++ = (unsigned char)value;
    return to;
}

void *memcpy(void *restrict to, const void *restrict from, size_t size)
{
    volatile unsigned char *p = to;
    const unsigned char *q = from;
    while (size--)
        *p++ = *q++;
    return to;
}

BYTES()
BYTES(4)
BYTES(8)
#endif
