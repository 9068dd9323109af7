/* FMI 3.0 co-simulation around model.h. Value reference 0 is time, 1 + group the others; arrays go as a whole. */
#define FMI_VERSION 3
#include "fmi.h"
#include "model.h"

typedef struct {
    model m;
    int initialised;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} instance;

static fmi3Status refuse(instance *s, const char *text)
{
    if (s && s->log)
        s->log(s->environment, fmi3Error, "logStatusError", text);
    return fmi3Error;
}

EXPORT const char *FMI(fmi3GetVersion)(void) { return "3.0"; }

EXPORT fmi3Status FMI(fmi3SetDebugLogging)(fmi3Instance i, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)i, (void)on, (void)n, (void)categories;
    return fmi3OK; /* only errors are ever logged */
}

EXPORT fmi3Instance FMI(fmi3InstantiateCoSimulation)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
    fmi3Boolean early, const fmi3ValueReference required[], size_t n, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)early, (void)required, (void)update;
    if (events || n > 0 || !token || strcmp(token, FMU_TOKEN) != 0) {
        if (log)
            log(environment, fmi3Error, "logStatusError",
                "no event mode, no intermediate variables, and the instantiation token of this very FMU");
        return NULL;
    }
    instance *s = calloc(1, sizeof *s);
    if (!s)
        return NULL;
    s->environment = environment;
    s->log = log;
    model_reset(&s->m);
    return s;
}

EXPORT fmi3Instance FMI(fmi3InstantiateModelExchange)(fmi3String a, fmi3String b, fmi3String c, fmi3Boolean d,
                                                      fmi3Boolean e, fmi3InstanceEnvironment f,
                                                      fmi3LogMessageCallback g)
{
    (void)a, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g;
    return NULL;
}

EXPORT fmi3Instance FMI(fmi3InstantiateScheduledExecution)(
    fmi3String a, fmi3String b, fmi3String c, fmi3Boolean d, fmi3Boolean e, fmi3InstanceEnvironment f,
    fmi3LogMessageCallback g, fmi3ClockUpdateCallback h, fmi3LockPreemptionCallback k, fmi3UnlockPreemptionCallback l)
{
    (void)a, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g, (void)h, (void)k, (void)l;
    return NULL;
}

EXPORT void FMI(fmi3FreeInstance)(fmi3Instance i) { free(i); }

EXPORT fmi3Status FMI(fmi3EnterInitializationMode)(fmi3Instance i, fmi3Boolean a, fmi3Float64 b, fmi3Float64 start,
                                                   fmi3Boolean c, fmi3Float64 d)
{
    instance *s = i;
    (void)a, (void)b, (void)c, (void)d;
    if (s->initialised)
        return refuse(s, "already initialised");
    model_start(&s->m, start);
    return fmi3OK;
}

EXPORT fmi3Status FMI(fmi3ExitInitializationMode)(fmi3Instance i)
{
    ((instance *)i)->initialised = 1;
    return fmi3OK;
}

EXPORT fmi3Status FMI(fmi3Terminate)(fmi3Instance i)
{
    (void)i;
    return fmi3OK;
}

EXPORT fmi3Status FMI(fmi3Reset)(fmi3Instance i)
{
    instance *s = i;
    s->initialised = 0;
    model_reset(&s->m);
    return fmi3OK;
}

EXPORT fmi3Status FMI(fmi3DoStep)(fmi3Instance i, fmi3Float64 point, fmi3Float64 step, fmi3Boolean no_set,
                                  fmi3Boolean *events, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    instance *s = i;
    (void)no_set;
    *events = *terminate = *early = 0;
    if (!s->initialised || model_advance(&s->m, point, step) != 0)
        return refuse(s, "fmi3DoStep: not initialised, not from where the last step ended, or no step forward");
    *last = s->m.time;
    return fmi3OK;
}

/* One getter and one setter per type; an array takes as many values as it has. */
#define ACCESS(Name, type, wanted)                                                                                \
    EXPORT fmi3Status FMI(fmi3Get##Name)(fmi3Instance i, const fmi3ValueReference r[], size_t n, type v[], size_t size) \
    {                                                                                                             \
        instance *s = i;                                                                                          \
        size_t k = 0;                                                                                             \
        for (size_t a = 0; a < n; a++) {                                                                          \
            if (wanted == REAL && r[a] == 0 && k < size) {                                                        \
                v[k++] = (type)s->m.time;                                                                         \
                continue;                                                                                         \
            }                                                                                                     \
            const long group = (long)r[a] - 1;                                                                    \
            const int count = group < GROUPS ? group_size((int)group) : 0;                                        \
            for (int j = 0; j < count || j == 0; j++) {                                                           \
                const double *x = variable(&s->m, group, j, wanted, 0);                                           \
                if (!x || k == size)                                                                              \
                    return refuse(s, "fmi3Get" #Name ": no such variable, or another number of values");          \
                v[k++] = (type)*x;                                                                                \
            }                                                                                                     \
        }                                                                                                         \
        return k == size ? fmi3OK : refuse(s, "fmi3Get" #Name ": another number of values");                      \
    }                                                                                                             \
    EXPORT fmi3Status FMI(fmi3Set##Name)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const type v[],        \
                                         size_t size)                                                             \
    {                                                                                                             \
        instance *s = i;                                                                                          \
        size_t k = 0;                                                                                             \
        for (size_t a = 0; a < n; a++) {                                                                          \
            const long group = (long)r[a] - 1;                                                                    \
            const int count = group < GROUPS ? group_size((int)group) : 0;                                        \
            for (int j = 0; j < count || j == 0; j++) {                                                           \
                double *x = variable(&s->m, group, j, wanted, 1);                                                 \
                if (!x || k == size || !allowed(group, (double)v[k]))                                             \
                    return refuse(s, "fmi3Set" #Name ": no such input, another number of values, or out of range"); \
                *x = (double)v[k++];                                                                              \
            }                                                                                                     \
        }                                                                                                         \
        return k == size ? fmi3OK : refuse(s, "fmi3Set" #Name ": another number of values");                      \
    }

ACCESS(Float64, fmi3Float64, REAL)
ACCESS(Int64, fmi3Int64, INTEGER)
ACCESS(Int32, fmi3Int32, INTEGER)
ACCESS(Boolean, fmi3Boolean, BOOLEAN)

/* Types without a variable. */
#define NONE(Name, type)                                                                                          \
    EXPORT fmi3Status FMI(fmi3Get##Name)(fmi3Instance i, const fmi3ValueReference r[], size_t n, type v[], size_t size) \
    {                                                                                                             \
        (void)r, (void)v;                                                                                         \
        return n || size ? refuse(i, "no variable is of type " #Name) : fmi3OK;                                   \
    }                                                                                                             \
    EXPORT fmi3Status FMI(fmi3Set##Name)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const type v[],        \
                                         size_t size)                                                             \
    {                                                                                                             \
        (void)r, (void)v;                                                                                         \
        return n || size ? refuse(i, "no variable is of type " #Name) : fmi3OK;                                   \
    }

NONE(Float32, fmi3Float32)
NONE(Int8, fmi3Int8)
NONE(UInt8, fmi3UInt8)
NONE(Int16, fmi3Int16)
NONE(UInt16, fmi3UInt16)
NONE(UInt32, fmi3UInt32)
NONE(UInt64, fmi3UInt64)
NONE(String, fmi3String)

EXPORT fmi3Status FMI(fmi3GetBinary)(fmi3Instance i, const fmi3ValueReference r[], size_t n, size_t sizes[],
                                     fmi3Binary v[], size_t size)
{
    (void)r, (void)sizes, (void)v;
    return n || size ? refuse(i, "no variable is binary") : fmi3OK;
}

EXPORT fmi3Status FMI(fmi3SetBinary)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const size_t sizes[],
                                     const fmi3Binary v[], size_t size)
{
    (void)r, (void)sizes, (void)v;
    return n || size ? refuse(i, "no variable is binary") : fmi3OK;
}

EXPORT fmi3Status FMI(fmi3GetClock)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Clock v[])
{
    (void)r, (void)v;
    return n ? refuse(i, "there is no clock") : fmi3OK;
}

EXPORT fmi3Status FMI(fmi3SetClock)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Clock v[])
{
    (void)r, (void)v;
    return n ? refuse(i, "there is no clock") : fmi3OK;
}

/* ---- state: a copy of the model ---- */

EXPORT fmi3Status FMI(fmi3GetFMUState)(fmi3Instance i, fmi3FMUState *state)
{
    if (!*state && !(*state = malloc(sizeof(instance))))
        return refuse(i, "out of memory");
    memcpy(*state, i, sizeof(instance));
    return fmi3OK;
}

static void take_over(instance *s, const instance *saved)
{
    s->m = saved->m;
    s->initialised = saved->initialised;
}

EXPORT fmi3Status FMI(fmi3SetFMUState)(fmi3Instance i, fmi3FMUState state)
{
    take_over(i, state);
    return fmi3OK;
}

EXPORT fmi3Status FMI(fmi3FreeFMUState)(fmi3Instance i, fmi3FMUState *state)
{
    (void)i;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

EXPORT fmi3Status FMI(fmi3SerializedFMUStateSize)(fmi3Instance i, fmi3FMUState state, size_t *size)
{
    (void)i, (void)state;
    *size = sizeof(model) + 1;
    return fmi3OK;
}

EXPORT fmi3Status FMI(fmi3SerializeFMUState)(fmi3Instance i, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    const instance *saved = state;
    if (size != sizeof(model) + 1)
        return refuse(i, "fmi3SerializeFMUState: another size");
    memcpy(bytes, &saved->m, sizeof(model));
    bytes[sizeof(model)] = (fmi3Byte)saved->initialised;
    return fmi3OK;
}

EXPORT fmi3Status FMI(fmi3DeserializeFMUState)(fmi3Instance i, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    if (size != sizeof(model) + 1)
        return refuse(i, "fmi3DeserializeFMUState: another size");
    if (FMI(fmi3GetFMUState)(i, state) != fmi3OK)
        return fmi3Error;
    instance *saved = *state;
    memcpy(&saved->m, bytes, sizeof(model));
    saved->initialised = bytes[sizeof(model)];
    return fmi3OK;
}

/* ---- what the model description says there is none of ---- */

EXPORT fmi3Status FMI(fmi3EnterEventMode)(fmi3Instance i) { return refuse(i, "there is no event mode"); }
EXPORT fmi3Status FMI(fmi3EnterStepMode)(fmi3Instance i) { return refuse(i, "there is no event mode"); }
EXPORT fmi3Status FMI(fmi3EnterConfigurationMode)(fmi3Instance i) { return refuse(i, "nothing to configure"); }
EXPORT fmi3Status FMI(fmi3ExitConfigurationMode)(fmi3Instance i) { return refuse(i, "nothing to configure"); }
EXPORT fmi3Status FMI(fmi3EvaluateDiscreteStates)(fmi3Instance i) { return refuse(i, "there is no event mode"); }

EXPORT fmi3Status FMI(fmi3UpdateDiscreteStates)(fmi3Instance i, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *c,
                                                fmi3Boolean *d, fmi3Boolean *e, fmi3Float64 *f)
{
    (void)a, (void)b, (void)c, (void)d, (void)e, (void)f;
    return refuse(i, "there is no event mode");
}

EXPORT fmi3Status FMI(fmi3GetOutputDerivatives)(fmi3Instance i, const fmi3ValueReference r[], size_t n,
                                                const fmi3Int32 orders[], fmi3Float64 v[], size_t size)
{
    (void)r, (void)n, (void)orders, (void)v, (void)size;
    return refuse(i, "outputs are held: they have no derivatives");
}

EXPORT fmi3Status FMI(fmi3GetDirectionalDerivative)(fmi3Instance i, const fmi3ValueReference u[], size_t a,
                                                    const fmi3ValueReference k[], size_t b, const fmi3Float64 seed[],
                                                    size_t c, fmi3Float64 v[], size_t d)
{
    (void)u, (void)a, (void)k, (void)b, (void)seed, (void)c, (void)v, (void)d;
    return refuse(i, "no directional derivatives");
}

EXPORT fmi3Status FMI(fmi3GetAdjointDerivative)(fmi3Instance i, const fmi3ValueReference u[], size_t a,
                                                const fmi3ValueReference k[], size_t b, const fmi3Float64 seed[],
                                                size_t c, fmi3Float64 v[], size_t d)
{
    (void)u, (void)a, (void)k, (void)b, (void)seed, (void)c, (void)v, (void)d;
    return refuse(i, "no adjoint derivatives");
}

EXPORT fmi3Status FMI(fmi3GetNumberOfVariableDependencies)(fmi3Instance i, fmi3ValueReference r, size_t *n)
{
    (void)r, (void)n;
    return refuse(i, "no dependencies at run time");
}

EXPORT fmi3Status FMI(fmi3GetVariableDependencies)(fmi3Instance i, fmi3ValueReference r, size_t a[],
                                                   fmi3ValueReference b[], size_t c[], fmi3DependencyKind d[], size_t n)
{
    (void)r, (void)a, (void)b, (void)c, (void)d, (void)n;
    return refuse(i, "no dependencies at run time");
}

#define CLOCKS(Name, ...)                                                                                         \
    EXPORT fmi3Status FMI(fmi3##Name)(fmi3Instance i, const fmi3ValueReference r[], size_t n, __VA_ARGS__)

CLOCKS(GetIntervalDecimal, fmi3Float64 a[], fmi3IntervalQualifier b[])
{
    (void)r, (void)n, (void)a, (void)b;
    return refuse(i, "there is no clock");
}

CLOCKS(GetIntervalFraction, fmi3UInt64 a[], fmi3UInt64 b[], fmi3IntervalQualifier c[])
{
    (void)r, (void)n, (void)a, (void)b, (void)c;
    return refuse(i, "there is no clock");
}

CLOCKS(GetShiftDecimal, fmi3Float64 a[])
{
    (void)r, (void)n, (void)a;
    return refuse(i, "there is no clock");
}

CLOCKS(GetShiftFraction, fmi3UInt64 a[], fmi3UInt64 b[])
{
    (void)r, (void)n, (void)a, (void)b;
    return refuse(i, "there is no clock");
}

CLOCKS(SetIntervalDecimal, const fmi3Float64 a[])
{
    (void)r, (void)n, (void)a;
    return refuse(i, "there is no clock");
}

CLOCKS(SetIntervalFraction, const fmi3UInt64 a[], const fmi3UInt64 b[])
{
    (void)r, (void)n, (void)a, (void)b;
    return refuse(i, "there is no clock");
}

CLOCKS(SetShiftDecimal, const fmi3Float64 a[])
{
    (void)r, (void)n, (void)a;
    return refuse(i, "there is no clock");
}

CLOCKS(SetShiftFraction, const fmi3UInt64 a[], const fmi3UInt64 b[])
{
    (void)r, (void)n, (void)a, (void)b;
    return refuse(i, "there is no clock");
}

/* ---- of the other interface types; importers may look for every function of the standard ---- */

EXPORT fmi3Status FMI(fmi3EnterContinuousTimeMode)(fmi3Instance i) { return refuse(i, "for co-simulation only"); }

EXPORT fmi3Status FMI(fmi3CompletedIntegratorStep)(fmi3Instance i, fmi3Boolean a, fmi3Boolean *b, fmi3Boolean *c)
{
    (void)a, (void)b, (void)c;
    return refuse(i, "for co-simulation only");
}

EXPORT fmi3Status FMI(fmi3SetTime)(fmi3Instance i, fmi3Float64 time)
{
    (void)time;
    return refuse(i, "for co-simulation only");
}

EXPORT fmi3Status FMI(fmi3SetContinuousStates)(fmi3Instance i, const fmi3Float64 x[], size_t n)
{
    (void)x;
    return n ? refuse(i, "there are no continuous states") : fmi3OK;
}

#define NO_STATES(Name)                                                                                           \
    EXPORT fmi3Status FMI(fmi3##Name)(fmi3Instance i, fmi3Float64 x[], size_t n)                                  \
    {                                                                                                             \
        (void)x;                                                                                                  \
        return n ? refuse(i, "there are no continuous states") : fmi3OK;                                          \
    }

NO_STATES(GetContinuousStateDerivatives)
NO_STATES(GetEventIndicators)
NO_STATES(GetContinuousStates)
NO_STATES(GetNominalsOfContinuousStates)

EXPORT fmi3Status FMI(fmi3GetNumberOfEventIndicators)(fmi3Instance i, size_t *n)
{
    (void)i;
    *n = 0;
    return fmi3OK;
}

EXPORT fmi3Status FMI(fmi3GetNumberOfContinuousStates)(fmi3Instance i, size_t *n)
{
    (void)i;
    *n = 0;
    return fmi3OK;
}

EXPORT fmi3Status FMI(fmi3ActivateModelPartition)(fmi3Instance i, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock, (void)time;
    return refuse(i, "for co-simulation only");
}
