/* The types of FMI 2.0 and 3.0 that a packed system calls and is called with: the package is built without the headers of
 * the standard. */
#ifndef FMI_H
#define FMI_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef _WIN32
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

/* FMI 2.0 */

typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;

enum { fmi2False = 0, fmi2True = 1 };
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;

typedef void fmi2Logger(fmi2ComponentEnvironment, fmi2String name, fmi2Status, fmi2String category, fmi2String format,
                        ...);

typedef struct {
    fmi2Logger *logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment environment;
} fmi2CallbackFunctions;

typedef fmi2Component fmi2Make(fmi2String name, fmi2Type, fmi2String guid, fmi2String resources,
                               const fmi2CallbackFunctions *, fmi2Boolean visible, fmi2Boolean logging);
typedef fmi2Status fmi2SetUp(fmi2Component, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                             fmi2Boolean stop_defined, fmi2Real stop);

/* FMI 3.0 */

typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8, fmi3Byte;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean, fmi3Clock;
typedef const char *fmi3String;
typedef const fmi3Byte *fmi3Binary;

enum { fmi3False = 0, fmi3True = 1 };
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;

typedef void fmi3Logger(fmi3InstanceEnvironment, fmi3Status, fmi3String category, fmi3String message);
typedef void fmi3IntermediateUpdate(fmi3InstanceEnvironment, fmi3Float64 time, fmi3Boolean set_requested,
                                    fmi3Boolean get_allowed, fmi3Boolean step_finished, fmi3Boolean can_return_early,
                                    fmi3Boolean *return_early, fmi3Float64 *return_time);
typedef fmi3Instance fmi3Make(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                              fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                              const fmi3ValueReference required[], size_t n_required, fmi3InstanceEnvironment,
                              fmi3Logger *, fmi3IntermediateUpdate *);
typedef fmi3Status fmi3EnterInitialization(fmi3Instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                           fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop);

#endif
