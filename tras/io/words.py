"""What the names of columns say: vocabularies of roles, in English, Spanish, Portuguese, French, Italian and German.

Names are those of loggers, Simulink, PX4 and ROS. A word of six letters or more may also be cut off (VELOCIDA), have
an ending (velocidades) or stand at the end of a compound (Motorspannung).
"""

import re
import unicodedata

TIME = set(
    "t time times timestamp zeit tout seconds second secs sec elapsed datetime tiempo tempo temps czas stamp epoch "
    "rostime uhrzeit hora clock zeitstempel".split()
)
_AROUND_TIME = set(
    "stamp elapsed sample sampling sim simulation header total totl missn real ros sys system value values since start "
    "s".split()
)
TRIAL = set(
    "trial run episode trajectory traj experiment repetition segment sequence session ensayo versuch essai".split()
)
INPUT = set(
    "u in input inputs torque torques tau force voltage volt cmd command control ctrl action actuator actuators pwm "
    "throttle duty current moment thrust steering stimulus excitation heater valve prbs aprbs chirp "
    "entrada entradas estimulo voltaje tension tensao fuerza forca corriente corrente mando comando aileron ailrn "
    "elevator elev rudder ruddr yoke joystick "
    "eingang spannung strom kraft drehmoment stellgroesse stellgrosse stellwert stellsignal anregung "
    "entree commande courant effort ingresso tensione corrente coppia forza".split()
)
STATE = set(
    "q x y z angle angles theta phi psi alpha beta gamma pitch yaw roll azimuth elevation heading hding pos position "
    "vel velocity speed omega rate state states output outputs out displacement height level temperature encoder rpm "
    "rev revs tacho "
    "gyro attitude altitude acceleration accel "
    "angulo posicion velocidad velocida salida altura nivel temperatura aceleracion desplazamiento inclinacion "
    "posicao velocidade saida aceleracao winkel lage geschwindigkeit drehzahl ausgang hohe hoehe temperatur weg "
    "beschleunigung position vitesse sortie hauteur niveau posizione velocita angolo uscita".split()
)
REFERENCE = set(
    "ref reference setpoint target desired des goal sp referencia referencias consigna sollwert soll referenz consigne "
    "riferimento demand demanded commanded wanted".split()
)
_CONTROL = ("control", "ctrl", "command", "effort")  # of what stands before it
_COUNTS_ONLY = re.compile(r"(?:column |channel |ch|ans|data|signals?|var)?\d+(?:_\d+)?", re.IGNORECASE)
# `Pitch Angle & Reference2`: one of two signals, and the label's order need not be that of the columns.
_SEVERAL = re.compile(r".*\s(?:&|and|und|y)\s.*?_?\d")
_UNCLEAR = set("time error err fehler erreur residual estimate estimated".split())
_BESIDE = set(
    "battery batt index idx counter count sample samples frame id no nr status flag mode comment note".split()
)
_NUMBERED = re.compile(r"(m|motor|esc|servo)_?\d", re.IGNORECASE)  # four of them: a quadrotor's motors
_STEP = set("dt ts tsample samplingtime sampletime samplingperiod deltax deltat sampleinterval tabtast periodo".split())
_RATE = set("fs samplingrate samplerate samplingfrequency samplefrequency".split())
UNITS_OF_TIME = {
    (1, 1): "s sec secs second seconds segundos segundo sekunden",
    (1, 10**3): "ms msec msecs millis millisecond milliseconds",
    (1, 10**6): "us µs μs usec usecs micros microsecond microseconds",
    (1, 10**9): "ns nsec nsecs nanos nanosecond nanoseconds",
    (60, 1): "min mins minute minutes",
    (3600, 1): "h hr hour hours",
}
UNITS_OF_TIME = {word: factor for factor, words in UNITS_OF_TIME.items() for word in words.split()}


def of(name: str) -> list[str]:
    """The words of a name, in lower case and without accents.

    >>> of("Motor_Ángulo2"), of("thetaDot")
    (['motor', 'angulo'], ['theta', 'dot'])
    """
    plain = "".join(c for c in unicodedata.normalize("NFKD", name.replace("ß", "ss")) if not unicodedata.combining(c))
    return [word.lower() for word in re.findall(r"[A-Z]?[^\W\d_A-Z]+|[A-Z]+", plain)]


def guess_role(name: str, others=()) -> str | None:
    """Return "time", "trial", "states", "inputs", "reference", "step" or "beside" (a counter, a battery), else None.

    ``others`` are the names beside it: of ``W_YAW`` beside ``YAW`` nobody knows what of the yaw it is.

    Examples
    --------
    >>> names = ("Time_ms", "run", "theta_dot", "dq2", "motorTorque", "u", "theta_ref", "torque_angle", "Motorspannung")
    >>> [guess_role(name) for name in names]
    ['time', 'trial', 'states', 'states', 'inputs', 'inputs', 'reference', None, 'inputs']
    >>> guess_role("W_YAW"), guess_role("W_YAW", ["YAW"]), guess_role("U_YAW", ["YAW"])
    ('states', None, 'inputs')
    """
    words = of(name)
    if not words:
        return None
    if _is_time(words) or "".join(words) in ("ts", "tsample"):
        return "time"  # or, with one value, the sampling time
    if "".join(words) in _STEP | _RATE:
        return "step"
    if all(word in _BESIDE for word in words):
        return "beside"
    if _SEVERAL.fullmatch(name):
        return None
    if words[0] in TRIAL and all(word in ("id", "no", "nr", "num", "number", "index") for word in words[1:]):
        return "trial"
    plain = INPUT | STATE
    if any((_in(REFERENCE, word) and word not in plain) or word.startswith("soll") for word in words):
        return None if says_nothing(name) else "reference"  # a scope of that name may show the state, too
    if words[0] in ("u", "tau", "input", "cmd", "actuator", "actuators") or words[-1] in _CONTROL:
        return "inputs" if not _UNCLEAR & set(words) else None  # u_phi: the input that moves phi
    if _NUMBERED.fullmatch(name) and sum(bool(_NUMBERED.fullmatch(other)) for other in others) > 1:
        return "inputs"
    roles = {role for role, words_of in (("states", STATE), ("inputs", INPUT)) if any(_in(words_of, w) for w in words)}
    if not roles and words == ["motor"]:
        return "inputs"
    if len(roles) > 1 or _UNCLEAR & set(words):
        return None
    if len(words) > 1 and len(words[0]) == 1 and words[0] not in "dv" and words[1:] in map(of, others):
        return None
    return roles.pop() if roles else None


def says_nothing(name: str) -> bool:
    """Whether a name only counts: column 3, CH2, one of a scope's signals without a name or with a common one.

    >>> [says_nothing(name) for name in ("3", "Scope1.signals2_1", "ans4", "Pitch & Reference2", "m1", "current")]
    [True, True, True, True, False, False]
    """
    return bool(_SEVERAL.fullmatch(name) or _COUNTS_ONLY.fullmatch(name.rpartition(".")[2]))


def step_of(name: str, value) -> float | None:
    """The sampling time in s that a value called ``name`` states: dt, Ts, 1 / fs; None if it states none.

    >>> step_of("Ts", "0.02"), step_of("fs [Hz]", 100), step_of("force", 0.02)
    (0.02, 0.01, None)
    """
    joined = "".join(of(re.sub(r"[\[(].*", "", str(name))))
    if joined not in _STEP | _RATE:
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    if not 0 < number < float("inf"):
        return None
    return number if joined in _STEP else 1 / number


def unit_in(name: str) -> str | None:
    """The unit of time at the end of a name: Time_ms.

    >>> unit_in("Time_ms"), unit_in("t"), unit_in("secs")
    ('ms', None, 'secs')
    """
    words = re.findall(r"[^\W\d_]+", name.lower())
    last = words[-1] if words else ""
    return last if last in UNITS_OF_TIME and (len(words) > 1 or len(last) > 2) else None


def _is_time(words):
    """Whether one word says time and all others are units of it or stand beside it: header.stamp.secs."""
    return bool(TIME & set(words)) and all(w in TIME or w in UNITS_OF_TIME or w in _AROUND_TIME for w in words)


def _in(vocabulary, word):
    """Whether a word, what it is the derivative of, or its stem is in a vocabulary: dq, qdot, velocida."""
    derived = {word.removeprefix("d"), *(word.removesuffix(suffix) for suffix in ("dot", "ddot", "d"))}
    if word in vocabulary or (vocabulary is STATE and derived & vocabulary):
        return True
    if len(word) < 6:
        return False
    return any(
        len(known) > 5 and (known.startswith(word) or word.startswith(known) or word.endswith(known))
        for known in vocabulary
    )
