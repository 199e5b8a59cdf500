/* Bullet calls for all drones of a swarm. Bullet loads this file as a plugin, and passes it a client of the same world and the
   processor of its commands (b3PluginContext.h). Commands are built by the functions of Bullet's C interface, which are looked
   up in the pybullet module that is already loaded. The processor executes them and writes its answers to our buffers.
   Declarations follow Bullet 3.25: SharedMemoryPublic.h, PhysicsClientC_API.h, PhysicsCommandProcessorInterface.h. */

#define _GNU_SOURCE
#include <Python.h>
#include <dlfcn.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum {
    MAGIC_NUMBER = 202010061, /* version of the plugin interface; Bullet loads no plugin with another number */
    CLIENT = 0, PROCESSOR = 11, /* offsets in the plugin context, in pointers */
    IS_CONNECTED = 4, PROCESS_COMMAND = 5, /* indices in the processor's table of virtual functions */
    LINK_FRAME = 1, WORLD_FRAME = 2, BASE = -1,
#ifdef __APPLE__
    RAYS = 4095, /* maximum number in a command; for more, none is answered */
#else
    RAYS = 16383,
#endif
    BUFFER = 1 << 16, /* bytes; an answer about one body takes 30 KB */
};

typedef void *handle;
struct ray_hit { double fraction; int body, link; double position[3], normal[3]; };
struct ray_hits { int count; struct ray_hit *hit; };

/* Functions of Bullet that are used: type of the result, name, types of the arguments. */
#define FUNCTIONS(F) \
    F(handle, b3InitStepSimulationCommand, (handle)) \
    F(handle, b3RequestActualStateCommandInit, (handle, int)) \
    F(int, b3GetStatusActualState, \
      (handle, int *, int *, int *, const double **, const double **, const double **, const double **)) \
    F(handle, b3ApplyExternalForceCommandInit, (handle)) \
    F(void, b3ApplyExternalForce, (handle, int, int, const double *, const double *, int)) \
    F(void, b3ApplyExternalTorque, (handle, int, int, const double *, int)) \
    F(handle, b3CreatePoseCommandInit, (handle, int)) \
    F(int, b3CreatePoseCommandSetBasePosition, (handle, double, double, double)) \
    F(int, b3CreatePoseCommandSetBaseOrientation, (handle, double, double, double, double)) \
    F(int, b3CreatePoseCommandSetBaseLinearVelocity, (handle, const double *)) \
    F(int, b3CreatePoseCommandSetBaseAngularVelocity, (handle, const double *)) \
    F(handle, b3CollisionFilterCommandInit, (handle)) \
    F(void, b3SetCollisionFilterGroupMask, (handle, int, int, int, int)) \
    F(handle, b3CreateRaycastBatchCommandInit, (handle)) \
    F(void, b3RaycastBatchAddRays, (handle, handle, const double *, const double *, int)) \
    F(void, b3RaycastBatchSetCollisionFilterMask, (handle, int)) \
    F(void, b3RaycastBatchSetNumThreads, (handle, int)) \
    F(void, b3GetRaycastInformation, (handle, struct ray_hits *)) \
    F(handle, b3SubmitClientCommandAndWaitStatus, (handle, handle))

#define DECLARE(result, name, arguments) result(*name) arguments;
static struct { FUNCTIONS(DECLARE) } api;

struct session {
    handle client, status;
    void *processor;
    _Bool (*process)(void *, const void *, void *, char *, int);
    ptrdiff_t to_velocity; /* from a state's pose to its velocity, in doubles */
    int64_t drones;
    const int32_t *body;
    double answer[BUFFER / sizeof(double)];
};

static handle client_seen;
static void *processor_seen;

int initPlugin_bulletuav(void **context) {
    client_seen = context[CLIENT];
    processor_seen = context[PROCESSOR];
    return MAGIC_NUMBER;
}
void exitPlugin_bulletuav(void **context) {}
int executePluginCommand_bulletuav(void **context, const void *arguments) { return 0; }

/* NULL if all functions were found in the module at `path`, else the name of the missing function. */
const char *batch_find(const char *path) {
#define NAME(result, name, arguments) #name,
    static const char *const names[] = {FUNCTIONS(NAME)};
    void *library = dlopen(path, RTLD_NOW | RTLD_NOLOAD), *found[sizeof names / sizeof *names];
    if (!library) return "a loaded pybullet module";
    for (size_t k = 0; k < sizeof names / sizeof *names; k++)
        if (!(found[k] = dlsym(library, names[k]))) return names[k];
    memcpy(&api, found, sizeof found); /* all or nothing: sessions may be open */
    return NULL;
}

static void run(struct session *s, handle command) {
    s->process(s->processor, command, s->status, (char *)s->answer, sizeof s->answer);
}

static const double *state(struct session *s, int body) {
    run(s, api.b3RequestActualStateCommandInit(s->client, body));
    return s->answer;
}

/* A session on the client that loaded this plugin last, for the bodies of `drones` drones; the array must outlive the session.
   NULL if the answers of the processor differ from those of Bullet's C interface. */
struct session *batch_open(int64_t drones, const int32_t *body) {
    struct session *s = calloc(1, sizeof *s);
    if (!s || !processor_seen) { free(s); return NULL; }
    void **functions = *(void ***)processor_seen;
    _Bool (*connected)(void *) = (_Bool (*)(void *))functions[IS_CONNECTED];
    s->client = client_seen, s->processor = processor_seen, s->drones = drones, s->body = body;
    s->process = (_Bool (*)(void *, const void *, void *, char *, int))functions[PROCESS_COMMAND];
    const double *pose, *velocity;
    s->status = api.b3SubmitClientCommandAndWaitStatus(s->client, api.b3RequestActualStateCommandInit(s->client, body[0]));
    if (api.b3GetStatusActualState(s->status, 0, 0, 0, 0, &pose, &velocity, 0) && connected(s->processor)) {
        s->to_velocity = velocity - pose;
        const double *direct = state(s, body[0]);
        if (!memcmp(direct, pose, 7 * sizeof *pose) && !memcmp(direct + s->to_velocity, velocity, 6 * sizeof *pose)) return s;
    }
    free(s);
    return NULL;
}

void batch_close(struct session *s) { free(s); }

/* Pose and velocity, world axes, of the drones of `mask`. */
void batch_read(struct session *s, const uint8_t *mask, double *position, double *quaternion, double *velocity, double *omega) {
    for (int64_t k = 0; k < s->drones; k++) {
        if (!mask[k]) continue;
        const double *pose = state(s, s->body[k]), *speed = pose + s->to_velocity;
        memcpy(position + 3 * k, pose, 3 * sizeof *pose);
        memcpy(quaternion + 4 * k, pose + 3, 4 * sizeof *pose);
        memcpy(velocity + 3 * k, speed, 3 * sizeof *pose);
        memcpy(omega + 3 * k, speed + 3, 3 * sizeof *pose);
    }
}

/* Applies a force (world axes, at `position`) and a torque (body axes) to each drone of `mask`, by one command each: of several
   forces in a command Bullet corrupts all but the first (it writes the n-th at index n and reads it at index 3 n). */
void batch_apply(struct session *s, const uint8_t *mask, const double *position, const double *force, const double *torque) {
    for (int64_t k = 0; k < s->drones; k++) {
        if (!mask[k]) continue;
        handle command = api.b3ApplyExternalForceCommandInit(s->client);
        api.b3ApplyExternalForce(command, s->body[k], BASE, force + 3 * k, position + 3 * k, WORLD_FRAME);
        run(s, command);
        command = api.b3ApplyExternalForceCommandInit(s->client);
        api.b3ApplyExternalTorque(command, s->body[k], BASE, torque + 3 * k, LINK_FRAME);
        run(s, command);
    }
}

void batch_step(struct session *s) { run(s, api.b3InitStepSimulationCommand(s->client)); }

/* A substep: wrenches, step, states. */
void batch_substep(struct session *s, const uint8_t *mask, const double *force, const double *torque, double *position,
                   double *quaternion, double *velocity, double *omega) {
    batch_apply(s, mask, position, force, torque);
    batch_step(s);
    batch_read(s, mask, position, quaternion, velocity, omega);
}

/* Fraction of each ray before it hits a body whose collision group is in `groups`; NaN for a ray without an answer. */
void batch_rays(struct session *s, int64_t rays, const double *start, const double *end, int groups, double *fraction) {
    for (int64_t first = 0; first < rays; first += RAYS) {
        int64_t part = rays - first < RAYS ? rays - first : RAYS;
        handle command = api.b3CreateRaycastBatchCommandInit(s->client);
        struct ray_hits found;
        api.b3RaycastBatchAddRays(s->client, command, start + 3 * first, end + 3 * first, (int)part);
        api.b3RaycastBatchSetCollisionFilterMask(command, groups);
        api.b3RaycastBatchSetNumThreads(command, 1);
        api.b3SubmitClientCommandAndWaitStatus(s->client, command);
        api.b3GetRaycastInformation(s->client, &found);
        for (int64_t k = 0; k < part; k++) fraction[first + k] = k < found.count ? found.hit[k].fraction : NAN;
    }
}

/* A command that sets the pose of a body. */
static handle pose_command(struct session *s, int body, const double *p, const double *q) {
    handle command = api.b3CreatePoseCommandInit(s->client, body);
    api.b3CreatePoseCommandSetBasePosition(command, p[0], p[1], p[2]);
    api.b3CreatePoseCommandSetBaseOrientation(command, q[0], q[1], q[2], q[3]);
    return command;
}

/* Poses of any bodies. */
void batch_pose(struct session *s, int64_t count, const int32_t *body, const double *position, const double *quaternion) {
    for (int64_t k = 0; k < count; k++) run(s, pose_command(s, body[k], position + 3 * k, quaternion + 4 * k));
}

/* Velocities, world axes, of any bodies. */
void batch_velocity(struct session *s, int64_t count, const int32_t *body, const double *velocity, const double *omega) {
    for (int64_t k = 0; k < count; k++) {
        handle command = api.b3CreatePoseCommandInit(s->client, body[k]);
        api.b3CreatePoseCommandSetBaseLinearVelocity(command, velocity + 3 * k);
        api.b3CreatePoseCommandSetBaseAngularVelocity(command, omega + 3 * k);
        run(s, command);
    }
}

/* The inverse of batch_read: sets poses and velocities of the drones of `mask`, by one command each, twice as fast as two. */
void batch_write(struct session *s, const uint8_t *mask, const double *position, const double *quaternion, const double *velocity,
                 const double *omega) {
    for (int64_t k = 0; k < s->drones; k++) {
        if (!mask[k]) continue;
        handle command = pose_command(s, s->body[k], position + 3 * k, quaternion + 4 * k);
        api.b3CreatePoseCommandSetBaseLinearVelocity(command, velocity + 3 * k);
        api.b3CreatePoseCommandSetBaseAngularVelocity(command, omega + 3 * k);
        run(s, command);
    }
}

/* Sets the collision group of any bodies, and the groups that they collide with. */
void batch_filter(struct session *s, int64_t count, const int32_t *body, int group, int meets) {
    for (int64_t k = 0; k < count; k++) {
        handle command = api.b3CollisionFilterCommandInit(s->client);
        api.b3SetCollisionFilterGroupMask(command, body[k], BASE, group, meets);
        run(s, command);
    }
}

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "_batch", .m_doc = "See bulletuav.engine.c_extension."};
PyMODINIT_FUNC PyInit__batch(void) { return PyModule_Create(&module); }
