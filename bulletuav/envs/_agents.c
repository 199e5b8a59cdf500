/* Dictionaries of agents in and out: what bulletuav.envs.agents does, in C.

   Arrays are read by the layout that NumPy documents for the C interface (PyArrayObject_fields), so that its headers are not
   needed to build this. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdint.h>

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

/* Whether `object` is an array (..., numbers of `type`) as it lies, with so many dimensions. */
static int lies(PyObject *object, int dimensions, PyObject *type) {
    if ((PyObject *)Py_TYPE(object) != ndarray) return 0;
    struct array *array = (struct array *)object;
    if (array->dimensions != dimensions || (type && array->type != type)) return 0;
    return (array->flags & CONTIGUOUS) && (array->flags & ALIGNED);
}

/* The type of an array (`size`,) whose numbers can be copied as they lie; -1 for anything else. */
static int kind_of(PyObject *object, Py_ssize_t size) {
    if (!lies(object, 1, NULL) || ((struct array *)object)->shape[0] != size) return -1;
    for (int k = 0; k < NUMBERS; k++)
        if (((struct array *)object)->type == types[k]) return k;
    return -1;
}

/* The row of the i-th agent, of `most`; -1 where there is none. */
static Py_ssize_t row_of(PyObject *rows, Py_ssize_t i, Py_ssize_t most) {
    Py_ssize_t row = rows == Py_None ? i : PyLong_AsSsize_t(PyList_GET_ITEM(rows, i));
    return row < most ? row : -1;
}

/* Whether agents are a list, and rows None or a list as long. */
static int fit(PyObject *agents, PyObject *rows) {
    return PyList_CheckExact(agents) &&
           (rows == Py_None || (PyList_CheckExact(rows) && PyList_GET_SIZE(rows) == PyList_GET_SIZE(agents)));
}

static PyObject *refuse(void) {
    if (!PyErr_Occurred()) PyErr_SetString(PyExc_TypeError, "see bulletuav.envs.agents for what is needed");
    return NULL;
}

/* take(actions, agents, rows, given) -> bool: copy the action of each agent to its row of `given` (1, N, A), float64; rows None
   for the first ones. False where one is missing or is not such an array; some may be copied then. */
static PyObject *take(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    if (count != 4 || !fit(arguments[1], arguments[2]) || !lies(arguments[3], 3, types[DOUBLE])) return refuse();
    PyObject *actions = arguments[0], *agents = arguments[1], *rows = arguments[2];
    struct array *given = (struct array *)arguments[3];
    if (!PyDict_CheckExact(actions) || PyDict_GET_SIZE(actions) != PyList_GET_SIZE(agents)) Py_RETURN_FALSE;
    Py_ssize_t size = given->shape[2];
    for (Py_ssize_t i = 0; i < PyList_GET_SIZE(agents); i++) {
        PyObject *action = PyDict_GetItemWithError(actions, PyList_GET_ITEM(agents, i));
        int kind = action ? kind_of(action, size) : -1;
        if (kind < 0) {
            if (PyErr_Occurred()) return NULL;
            Py_RETURN_FALSE;
        }
        Py_ssize_t row = row_of(rows, i, given->shape[1]);
        if (row < 0) return refuse();
        double *to = (double *)given->data + row * size;
        const void *from = ((struct array *)action)->data;
        for (Py_ssize_t k = 0; k < size; k++)
            to[k] = kind == DOUBLE ? ((const double *)from)[k]
                  : kind == SINGLE ? ((const float *)from)[k]
                  : kind == INT64  ? (double)((const int64_t *)from)[k]
                                   : ((const int32_t *)from)[k];
    }
    Py_RETURN_TRUE;
}

/* Put a new reference into a dict. */
static int put(PyObject *dict, PyObject *agent, PyObject *value) {
    if (!value) return -1;
    int failed = PyDict_SetItem(dict, agent, value);
    Py_DECREF(value);
    return failed;
}

/* share(agents, rows, observations, rewards, terminated, truncated) -> four dicts: the rows of arrays (N, ...), float64 and
   bool but for the observations; rows None for the first ones. */
static PyObject *share(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    if (count != 6 || !fit(arguments[0], arguments[1]) || !lies(arguments[3], 1, types[DOUBLE])) return refuse();
    if (!lies(arguments[4], 1, types[BOOL]) || !lies(arguments[5], 1, types[BOOL])) return refuse();
    PyObject *agents = arguments[0], *rows = arguments[1], *observations = arguments[2];
    struct array *sums = (struct array *)arguments[3], *ends = (struct array *)arguments[4], *cuts = (struct array *)arguments[5];
    if (ends->shape[0] != sums->shape[0] || cuts->shape[0] != sums->shape[0]) return refuse();
    const double *rewards = (const double *)sums->data;
    const char *terminated = ends->data, *truncated = cuts->data;
    PyObject *seen = PyDict_New(), *earned = PyDict_New(), *ended = PyDict_New(), *cut = PyDict_New();
    if (!seen || !earned || !ended || !cut) goto failed;
    for (Py_ssize_t i = 0; i < PyList_GET_SIZE(agents); i++) {
        PyObject *agent = PyList_GET_ITEM(agents, i);
        Py_ssize_t row = row_of(rows, i, sums->shape[0]);
        if (row < 0) {
            refuse();
            goto failed;
        }
        if (put(seen, agent, PySequence_GetItem(observations, row)) < 0) goto failed;
        if (put(earned, agent, PyFloat_FromDouble(rewards[row])) < 0) goto failed;
        if (put(ended, agent, PyBool_FromLong(terminated[row])) < 0) goto failed;
        if (put(cut, agent, PyBool_FromLong(truncated[row])) < 0) goto failed;
    }
    return Py_BuildValue("(NNNN)", seen, earned, ended, cut);
failed:
    Py_XDECREF(seen), Py_XDECREF(earned), Py_XDECREF(ended), Py_XDECREF(cut);
    return NULL;
}

static PyMethodDef methods[] = {
    {"take", (PyCFunction)(void (*)(void))take, METH_FASTCALL, "See bulletuav.envs.agents."},
    {"share", (PyCFunction)(void (*)(void))share, METH_FASTCALL, "See bulletuav.envs.agents."},
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
    return PyModule_Create(&module);
}
