/* FMI 2.0 co-simulation around model.h. A value reference is 16 * group + joint. */
#define FMI_VERSION 2
#include "fmi.h"
#include "model.h"

typedef struct {
    model m;
    int initialised;
    const fmi2CallbackFunctions *callbacks;
    fmi2String name;
} instance;

static fmi2Status refuse(instance *s, const char *text)
{
    if (s && s->callbacks && s->callbacks->logger)
        s->callbacks->logger(s->callbacks->componentEnvironment, s->name, fmi2Error, "logStatusError", "%s", text);
    return fmi2Error;
}

EXPORT const char *FMI(fmi2GetTypesPlatform)(void) { return "default"; }
EXPORT const char *FMI(fmi2GetVersion)(void) { return "2.0"; }

EXPORT fmi2Status FMI(fmi2SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK; /* only errors are ever logged */
}

EXPORT fmi2Component FMI(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    instance wanted = {.callbacks = callbacks, .name = name};
    (void)resources, (void)visible, (void)logging;
    if (type != fmi2CoSimulation || !guid || strcmp(guid, FMU_TOKEN) != 0) {
        refuse(&wanted, "for co-simulation only, with the GUID of this very FMU");
        return NULL;
    }
    instance *s = calloc(1, sizeof *s);
    char *kept = malloc(strlen(name ? name : "") + 1);
    if (!s || !kept) {
        free(s);
        free(kept);
        return NULL;
    }
    s->callbacks = callbacks;
    s->name = strcpy(kept, name ? name : "");
    model_reset(&s->m);
    return s;
}

EXPORT void FMI(fmi2FreeInstance)(fmi2Component c)
{
    instance *s = c;
    if (s)
        free((char *)s->name);
    free(s);
}

EXPORT fmi2Status FMI(fmi2SetupExperiment)(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real start, fmi2Boolean d,
                                           fmi2Real e)
{
    (void)a, (void)b, (void)d, (void)e;
    model_start(&((instance *)c)->m, start);
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2EnterInitializationMode)(fmi2Component c)
{
    return ((instance *)c)->initialised ? refuse(c, "already initialised") : fmi2OK;
}

EXPORT fmi2Status FMI(fmi2ExitInitializationMode)(fmi2Component c)
{
    ((instance *)c)->initialised = 1;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2Terminate)(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2Reset)(fmi2Component c)
{
    ((instance *)c)->initialised = 0;
    model_reset(&((instance *)c)->m);
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2DoStep)(fmi2Component c, fmi2Real point, fmi2Real step, fmi2Boolean no_set)
{
    instance *s = c;
    (void)no_set;
    if (!s->initialised || model_advance(&s->m, point, step) != 0)
        return refuse(s, "fmi2DoStep: not initialised, not from where the last step ended, or no step forward");
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2CancelStep)(fmi2Component c) { return refuse(c, "no step is pending"); }

#define ACCESS(Name, type, wanted)                                                                                \
    EXPORT fmi2Status FMI(fmi2Get##Name)(fmi2Component c, const fmi2ValueReference r[], size_t n, type v[])       \
    {                                                                                                             \
        instance *s = c;                                                                                          \
        for (size_t a = 0; a < n; a++) {                                                                          \
            const double *x = variable(&s->m, (long)(r[a] / 16), (int)(r[a] % 16), wanted, 0);                    \
            if (!x)                                                                                               \
                return refuse(s, "fmi2Get" #Name ": no such variable");                                           \
            v[a] = (type)*x;                                                                                      \
        }                                                                                                         \
        return fmi2OK;                                                                                            \
    }                                                                                                             \
    EXPORT fmi2Status FMI(fmi2Set##Name)(fmi2Component c, const fmi2ValueReference r[], size_t n, const type v[]) \
    {                                                                                                             \
        instance *s = c;                                                                                          \
        for (size_t a = 0; a < n; a++) {                                                                          \
            double *x = variable(&s->m, (long)(r[a] / 16), (int)(r[a] % 16), wanted, 1);                          \
            if (!x || !allowed((long)(r[a] / 16), (double)v[a]))                                                  \
                return refuse(s, "fmi2Set" #Name ": no such input, or out of range");                             \
            *x = (double)v[a];                                                                                    \
        }                                                                                                         \
        return fmi2OK;                                                                                            \
    }

ACCESS(Real, fmi2Real, REAL)
ACCESS(Integer, fmi2Integer, INTEGER)
ACCESS(Boolean, fmi2Boolean, BOOLEAN)

EXPORT fmi2Status FMI(fmi2GetString)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[])
{
    (void)r, (void)v;
    return n ? refuse(c, "no variable is a string") : fmi2OK;
}

EXPORT fmi2Status FMI(fmi2SetString)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[])
{
    (void)r, (void)v;
    return n ? refuse(c, "no variable is a string") : fmi2OK;
}

/* ---- state: a copy of the model ---- */

typedef struct {
    model m;
    int initialised;
} saved;

EXPORT fmi2Status FMI(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    const instance *s = c;
    if (!*state && !(*state = calloc(1, sizeof(saved))))
        return refuse(c, "out of memory");
    ((saved *)*state)->m = s->m;
    ((saved *)*state)->initialised = s->initialised;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state)
{
    ((instance *)c)->m = ((const saved *)state)->m;
    ((instance *)c)->initialised = ((const saved *)state)->initialised;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(saved);
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (size != sizeof(saved))
        return refuse(c, "fmi2SerializeFMUstate: another size");
    memcpy(bytes, state, size);
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    if (size != sizeof(saved))
        return refuse(c, "fmi2DeSerializeFMUstate: another size");
    if (!*state && !(*state = malloc(size)))
        return refuse(c, "out of memory");
    memcpy(*state, bytes, size);
    return fmi2OK;
}

/* ---- status of a step, and what the model description says there is none of ---- */

EXPORT fmi2Status FMI(fmi2GetStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    *value = fmi2OK;
    return kind == fmi2DoStepStatus ? fmi2OK : refuse(c, "fmi2GetStatus: no such status");
}

EXPORT fmi2Status FMI(fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    *value = ((instance *)c)->m.time;
    return kind == fmi2LastSuccessfulTime ? fmi2OK : refuse(c, "fmi2GetRealStatus: no such status");
}

EXPORT fmi2Status FMI(fmi2GetIntegerStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)kind, (void)value;
    return refuse(c, "fmi2GetIntegerStatus: no such status");
}

EXPORT fmi2Status FMI(fmi2GetBooleanStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    *value = fmi2False;
    return kind == fmi2Terminated ? fmi2OK : refuse(c, "fmi2GetBooleanStatus: no such status");
}

EXPORT fmi2Status FMI(fmi2GetStringStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    *value = "";
    return kind == fmi2PendingStatus ? fmi2OK : refuse(c, "fmi2GetStringStatus: no such status");
}

EXPORT fmi2Status FMI(fmi2SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                                   const fmi2Integer order[], const fmi2Real v[])
{
    (void)r, (void)n, (void)order, (void)v;
    return refuse(c, "inputs are sampled: they have no derivatives");
}

EXPORT fmi2Status FMI(fmi2GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                                    const fmi2Integer order[], fmi2Real v[])
{
    (void)r, (void)n, (void)order, (void)v;
    return refuse(c, "outputs are held: they have no derivatives");
}

EXPORT fmi2Status FMI(fmi2GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference u[], size_t a,
                                                    const fmi2ValueReference k[], size_t b, const fmi2Real dk[],
                                                    fmi2Real du[])
{
    (void)u, (void)a, (void)k, (void)b, (void)dk, (void)du;
    return refuse(c, "no directional derivatives");
}
