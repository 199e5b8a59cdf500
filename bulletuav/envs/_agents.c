/* C implementations of Python functions around a decision: conversion of dictionaries by agent (bulletuav.envs.agents), setpoints
   of an airspace (bulletuav.envs.airspace_inputs), and methods that exclude other threads (bulletuav.envs.environment).

   Arrays are read by the memory layout that NumPy documents for the C interface (PyArrayObject_fields), so that its headers are
   not needed to build this. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <structmember.h>

struct array {
    PyObject_HEAD
    char *data;
    int dimensions;
    Py_ssize_t *shape, *strides;
    PyObject *base, *type;
    int flags;
};
enum { CONTIGUOUS = 1, ALIGNED = 0x100 };
enum { DOUBLE, SINGLE, INT64, INT32, NUMBERS, BOOL = NUMBERS, TYPES };

static PyObject *ndarray, *types[TYPES];

/* Return 1 if `object` is a contiguous, aligned array of `type` (NULL for any) with this number of dimensions. */
static int lies(PyObject *object, int dimensions, PyObject *type) {
    if ((PyObject *)Py_TYPE(object) != ndarray) return 0;
    struct array *array = (struct array *)object;
    if (array->dimensions != dimensions || (type && array->type != type)) return 0;
    return (array->flags & CONTIGUOUS) && (array->flags & ALIGNED);
}

/* Return the type of a contiguous array (`size`,) of numbers; -1 for anything else. */
static int kind_of(PyObject *object, Py_ssize_t size) {
    if (!lies(object, 1, NULL) || ((struct array *)object)->shape[0] != size) return -1;
    for (int k = 0; k < NUMBERS; k++)
        if (((struct array *)object)->type == types[k]) return k;
    return -1;
}

/* Copy an action (`size`,); return 0 if it is not such an array. */
static int copy(PyObject *action, Py_ssize_t size, double *to) {
    int kind = kind_of(action, size);
    if (kind < 0) return 0;
    const void *from = ((struct array *)action)->data;
    for (Py_ssize_t k = 0; k < size; k++)
        to[k] = kind == DOUBLE ? ((const double *)from)[k]
              : kind == SINGLE ? ((const float *)from)[k]
              : kind == INT64  ? (double)((const int64_t *)from)[k]
                               : ((const int32_t *)from)[k];
    return 1;
}

/* Return the row of the i-th agent, below `most`; -1 if there is none. */
static Py_ssize_t row_of(PyObject *rows, Py_ssize_t i, Py_ssize_t most) {
    Py_ssize_t row = rows == Py_None ? i : PyLong_AsSsize_t(PyList_GET_ITEM(rows, i));
    return row < most ? row : -1;
}

/* Return 1 if agents are a list, and rows None or a list of the same length. */
static int fit(PyObject *agents, PyObject *rows) {
    return PyList_CheckExact(agents) &&
           (rows == Py_None || (PyList_CheckExact(rows) && PyList_GET_SIZE(rows) == PyList_GET_SIZE(agents)));
}

static PyObject *refuse(void) {
    if (!PyErr_Occurred()) PyErr_SetString(PyExc_TypeError, "see bulletuav.envs.agents for what is needed");
    return NULL;
}

/* take(actions, agents, rows, given) -> bool: copy the action of each agent to its row of `given` (1, N, A), float64; rows None
   for the first ones. False if an action is missing or is not such an array; some may be copied then. */
static PyObject *take(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    if (count != 4 || !fit(arguments[1], arguments[2]) || !lies(arguments[3], 3, types[DOUBLE])) return refuse();
    PyObject *actions = arguments[0], *agents = arguments[1], *rows = arguments[2];
    struct array *given = (struct array *)arguments[3];
    if (!PyDict_CheckExact(actions) || PyDict_GET_SIZE(actions) != PyList_GET_SIZE(agents)) Py_RETURN_FALSE;
    Py_ssize_t size = given->shape[2];
    for (Py_ssize_t i = 0; i < PyList_GET_SIZE(agents); i++) {
        PyObject *action = PyDict_GetItemWithError(actions, PyList_GET_ITEM(agents, i));
        Py_ssize_t row = row_of(rows, i, given->shape[1]);
        if (row < 0) return refuse();
        if (!action || !copy(action, size, (double *)given->data + row * size)) {
            if (PyErr_Occurred()) return NULL;
            Py_RETURN_FALSE;
        }
    }
    Py_RETURN_TRUE;
}

/* take_one(action, given) -> bool: copy an action (A,) to `given` (1, 1, A), float64. False if it is not such an array. */
static PyObject *take_one(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    if (count != 2 || !lies(arguments[1], 3, types[DOUBLE])) return refuse();
    struct array *given = (struct array *)arguments[1];
    if (given->shape[0] != 1 || given->shape[1] != 1) return refuse();
    return PyBool_FromLong(copy(arguments[0], given->shape[2], (double *)given->data));
}

/* Set an item of a dict, and release the reference to the value. */
static int put(PyObject *dict, PyObject *agent, PyObject *value) {
    if (!value) return -1;
    int failed = PyDict_SetItem(dict, agent, value);
    Py_DECREF(value);
    return failed;
}

/* Return 1 for a contiguous array (1, rows); any number of rows if negative. */
static int is_world(PyObject *object, PyObject *type, Py_ssize_t rows) {
    if (!lies(object, 2, type)) return 0;
    Py_ssize_t *shape = ((struct array *)object)->shape;
    return shape[0] == 1 && (rows < 0 || shape[1] == rows);
}

/* share(agents, rows, observations, rewards, terminated, truncated) -> four dicts by agent, and whether any episode ended: rows of
   arrays (1, N, ...), of float64 and bool except for the observations; rows None for the first ones. */
static PyObject *share(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    if (count != 6 || !fit(arguments[0], arguments[1]) || !is_world(arguments[3], types[DOUBLE], -1)) return refuse();
    PyObject *agents = arguments[0], *rows = arguments[1];
    struct array *sums = (struct array *)arguments[3], *ends = (struct array *)arguments[4], *cuts = (struct array *)arguments[5];
    Py_ssize_t drones = sums->shape[1];
    if (!is_world(arguments[4], types[BOOL], drones) || !is_world(arguments[5], types[BOOL], drones)) return refuse();
    PyObject *observations = PySequence_GetItem(arguments[2], 0);
    if (!observations) return NULL;
    const double *rewards = (const double *)sums->data;
    const char *terminated = ends->data, *truncated = cuts->data;
    int any = 0;
    PyObject *seen = PyDict_New(), *earned = PyDict_New(), *ended = PyDict_New(), *cut = PyDict_New();
    if (!seen || !earned || !ended || !cut) goto failed;
    for (Py_ssize_t i = 0; i < PyList_GET_SIZE(agents); i++) {
        PyObject *agent = PyList_GET_ITEM(agents, i);
        Py_ssize_t row = row_of(rows, i, drones);
        if (row < 0) {
            refuse();
            goto failed;
        }
        any |= terminated[row] | truncated[row];
        if (put(seen, agent, PySequence_GetItem(observations, row)) < 0) goto failed;
        if (put(earned, agent, PyFloat_FromDouble(rewards[row])) < 0) goto failed;
        if (put(ended, agent, PyBool_FromLong(terminated[row])) < 0) goto failed;
        if (put(cut, agent, PyBool_FromLong(truncated[row])) < 0) goto failed;
    }
    Py_DECREF(observations);
    return Py_BuildValue("(NNNNN)", seen, earned, ended, cut, PyBool_FromLong(any));
failed:
    Py_DECREF(observations), Py_XDECREF(seen), Py_XDECREF(earned), Py_XDECREF(ended), Py_XDECREF(cut);
    return NULL;
}

enum { ATTITUDE_LEVEL = 3, YAW = 3 }; /* of SetpointLevel, and of a setpoint's columns */

/* Return the numbers of `given`: those of a contiguous float64 array in place, those of a tuple of floats copied to `room`. NULL for
   anything else, and for numbers above 1e6, which Python checks. */
static const double *numbers_of(PyObject *given, double *room, Py_ssize_t most, Py_ssize_t *count, int *dimensions) {
    const double *numbers = room;
    *dimensions = 1;
    if (PyTuple_CheckExact(given)) {
        if ((*count = PyTuple_GET_SIZE(given)) > most) return NULL;
        for (Py_ssize_t k = 0; k < *count; k++) {
            PyObject *one = PyTuple_GET_ITEM(given, k);
            if (!PyFloat_CheckExact(one)) return NULL;
            room[k] = PyFloat_AS_DOUBLE(one);
        }
    } else if (lies(given, 1, types[DOUBLE]) || lies(given, 2, types[DOUBLE])) {
        struct array *array = (struct array *)given;
        *dimensions = array->dimensions;
        *count = array->shape[array->dimensions - 1] * (array->dimensions == 2 ? array->shape[0] : 1);
        numbers = (const double *)array->data;
    } else {
        return NULL;
    }
    for (Py_ssize_t k = 0; k < *count; k++)
        if (!(fabs(numbers[k]) < 1e6)) return NULL;
    return numbers;
}

/* hold(levels, setpoint, commanded, drones, level, width, numbers) -> bool: write setpoints of one level with `width` numbers; see
   bulletuav.envs.airspace_inputs. False, with nothing written, if the arguments need further checks. */
static PyObject *hold(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    if (count != 7 || !is_world(arguments[0], types[INT64], -1) || !lies(arguments[1], 3, types[DOUBLE])) return refuse();
    Py_ssize_t drones = ((struct array *)arguments[0])->shape[1], first = 0, last = drones;
    struct array *setpoint = (struct array *)arguments[1];
    if (!is_world(arguments[2], types[BOOL], drones) || setpoint->shape[0] != 1 || setpoint->shape[1] != drones) return refuse();
    int64_t *levels = (int64_t *)((struct array *)arguments[0])->data;
    char *commanded = ((struct array *)arguments[2])->data;
    long level = PyLong_AsLong(arguments[4]), width = PyLong_AsLong(arguments[5]);
    if (PyErr_Occurred()) return NULL;
    Py_ssize_t room = setpoint->shape[2];
    if (width < 1 || width > room) return refuse();
    if (PyLong_CheckExact(arguments[3])) {
        first = PyLong_AsSsize_t(arguments[3]);
        if (first < 0 || first >= drones) {
            PyErr_Clear();
            Py_RETURN_FALSE;
        }
        last = first + 1;
    } else if (arguments[3] != Py_None) {
        Py_RETURN_FALSE;
    }
    double own[16];
    Py_ssize_t given;
    int dimensions;
    const double *numbers = numbers_of(arguments[6], own, sizeof own / sizeof *own, &given, &dimensions);
    if (!numbers) Py_RETURN_FALSE;
    Py_ssize_t each = dimensions == 2 ? ((struct array *)arguments[6])->shape[1] : given;
    if (dimensions == 2 && (arguments[3] != Py_None || given != each * drones)) Py_RETURN_FALSE;
    if (each == YAW && level < ATTITUDE_LEVEL && width == YAW + 1) {
        /* Without the yaw, if all drones hold one already */
        for (Py_ssize_t i = first; i < last; i++)
            if (!commanded[i] || levels[i] >= ATTITUDE_LEVEL) Py_RETURN_FALSE;
    } else if (each != width) {
        Py_RETURN_FALSE;
    }
    double *to = (double *)setpoint->data + first * room;
    for (Py_ssize_t i = first; i < last; i++, to += room) {
        for (Py_ssize_t k = 0; k < each; k++) to[k] = numbers[k];
        if (dimensions == 2) numbers += each;
        levels[i] = level;
        commanded[i] = 1;
    }
    Py_RETURN_TRUE;
}

/* A method that excludes other threads. */
struct guard {
    PyObject_HEAD
    PyObject *method, *dict;
    vectorcallfunc call;
};
static PyTypeObject *guard_type;
static PyObject *busy_name, *user, *update_wrapper;

static PyObject *guarded(PyObject *self, PyObject *const *arguments, size_t flags, PyObject *names) {
    PyObject *method = ((struct guard *)self)->method;
    if (PyVectorcall_NARGS(flags) < 1) return PyObject_Vectorcall(method, arguments, flags, names);
    PyObject *busy = PyObject_GetAttr(arguments[0], busy_name);
    if (!busy) return NULL;
    PyObject *me = PyDict_CheckExact(busy) ? Py_BuildValue("(k)", PyThread_get_thread_ident()) : NULL, *result = NULL;
    if (!me) {
        if (!PyErr_Occurred()) refuse();
        goto done;
    }
    PyObject *who = PyDict_SetDefault(busy, user, me);
    int same = who ? who == me ? 1 : PyObject_RichCompareBool(who, me, Py_EQ) : -1;
    if (same == 0)
        PyErr_Format(PyExc_RuntimeError, "this %s is in use by another thread: give each thread an environment of its own",
                     Py_TYPE(arguments[0])->tp_name);
    if (same != 1) goto done;
    result = PyObject_Vectorcall(method, arguments, flags, names);
    PyObject *kind, *error, *trace;
    PyErr_Fetch(&kind, &error, &trace);
    if (PyDict_GetItemWithError(busy, user) == me) PyDict_DelItem(busy, user);
    PyErr_Restore(kind, error, trace);
done:
    Py_DECREF(busy), Py_XDECREF(me);
    return result;
}

static PyObject *guard_bind(PyObject *self, PyObject *instance, PyObject *type) {
    return instance ? PyMethod_New(self, instance) : Py_NewRef(self);
}

static int guard_traverse(PyObject *self, visitproc visit, void *arg) {
    Py_VISIT(Py_TYPE(self));
    Py_VISIT(((struct guard *)self)->method);
    Py_VISIT(((struct guard *)self)->dict);
    return 0;
}

static int guard_clear(PyObject *self) {
    Py_CLEAR(((struct guard *)self)->method);
    Py_CLEAR(((struct guard *)self)->dict);
    return 0;
}

static void guard_dealloc(PyObject *self) {
    PyTypeObject *type = Py_TYPE(self);
    PyObject_GC_UnTrack(self);
    guard_clear(self);
    type->tp_free(self);
    Py_DECREF(type);
}

static PyMemberDef guard_members[] = {
    {"__vectorcalloffset__", T_PYSSIZET, offsetof(struct guard, call), READONLY},
    {"__dictoffset__", T_PYSSIZET, offsetof(struct guard, dict), READONLY},
    {NULL},
};
static PyGetSetDef guard_dict[] = {{"__dict__", PyObject_GenericGetDict, PyObject_GenericSetDict}, {NULL}};
static PyType_Slot guard_slots[] = {
    {Py_tp_call, PyVectorcall_Call}, {Py_tp_descr_get, guard_bind}, {Py_tp_traverse, guard_traverse}, {Py_tp_clear, guard_clear},
    {Py_tp_dealloc, guard_dealloc}, {Py_tp_members, guard_members}, {Py_tp_getset, guard_dict}, {0, NULL},
};
static PyType_Spec guard_spec = {
    "bulletuav.envs._agents.exclusive_method", sizeof(struct guard), 0,
    Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC | Py_TPFLAGS_HAVE_VECTORCALL | Py_TPFLAGS_METHOD_DESCRIPTOR |
        Py_TPFLAGS_DISALLOW_INSTANTIATION,
    guard_slots,
};

/* exclusive(method) -> the method, which raises RuntimeError while another thread is in an exclusive method of the instance. */
static PyObject *exclusive(PyObject *self, PyObject *method) {
    struct guard *made = PyObject_GC_New(struct guard, guard_type);
    if (!made) return NULL;
    made->method = Py_NewRef(method), made->dict = NULL, made->call = guarded;
    PyObject_GC_Track(made);
    PyObject *result = PyObject_CallFunctionObjArgs(update_wrapper, made, method, NULL);
    Py_DECREF(made);
    return result;
}

static PyMethodDef methods[] = {
    {"take", (PyCFunction)(void (*)(void))take, METH_FASTCALL, "See bulletuav.envs.agents."},
    {"take_one", (PyCFunction)(void (*)(void))take_one, METH_FASTCALL, "See bulletuav.envs.agents."},
    {"share", (PyCFunction)(void (*)(void))share, METH_FASTCALL, "See bulletuav.envs.agents."},
    {"hold", (PyCFunction)(void (*)(void))hold, METH_FASTCALL, "See bulletuav.envs.airspace_inputs."},
    {"exclusive", exclusive, METH_O, "See bulletuav.envs.environment."},
    {NULL, NULL, 0, NULL},
};
static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "_agents", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit__agents(void) {
    static const char *const names[TYPES] = {"float64", "float32", "int64", "int32", "bool"};
    PyObject *numpy = PyImport_ImportModule("numpy");
    if (!numpy) return NULL;
    ndarray = PyObject_GetAttrString(numpy, "ndarray");
    for (int k = 0; k < TYPES; k++) types[k] = PyObject_CallMethod(numpy, "dtype", "s", names[k]);
    Py_DECREF(numpy);
    if (!ndarray) return NULL;
    for (int k = 0; k < TYPES; k++)
        if (!types[k]) return NULL;
    PyObject *functools = PyImport_ImportModule("functools");
    if (!functools) return NULL;
    update_wrapper = PyObject_GetAttrString(functools, "update_wrapper");
    Py_DECREF(functools);
    guard_type = (PyTypeObject *)PyType_FromSpec(&guard_spec);
    busy_name = PyUnicode_InternFromString("_busy"), user = PyUnicode_InternFromString("user");
    if (!update_wrapper || !guard_type || !busy_name || !user) return NULL;
    return PyModule_Create(&module);
}
