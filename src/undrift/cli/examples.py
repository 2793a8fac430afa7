"""Examples at the end of each --help: calls as they may be typed, by command."""

EXAMPLES: dict[str, tuple[str, ...]] = {
    "": (
        "undrift info walk.csv --write-map map.toml",
        "undrift calibrate poses.csv --map map.toml -o calibration.json",
        "undrift correct walk.csv --calibration calibration.json -o corrected.parquet",
    ),
    "info": (
        "undrift info walk.csv",
        "undrift info walk.csv --write-map map.toml --sample-rate-hz 100",
        "undrift info calibration.json --details",
    ),
    "calibrate": (
        "undrift calibrate poses.csv --map map.toml -o calibration.json",
        "undrift calibrate turns.csv --turn-deg 360 --latitude-deg 52 --height-m 40",
        "undrift calibrate session/ -o calibration.json --report calibration.html",
    ),
    "session": (
        "undrift session new poses.csv --map map.toml -o session/",
        "undrift session new --help",
    ),
    "session new": (
        "undrift session new poses.csv --map map.toml -o session/",
        "undrift session new turns.csv --turn-deg 360 --serial A17 -o session/",
    ),
    "drift": (
        "undrift drift soak/ --calibration calibration.json -o calibration.json",
        "undrift drift warm_up.csv --map map.toml --warm-up --report drift.html",
    ),
    "learn": (
        "undrift learn 2026-03-*.csv --calibration c.json -o c2.json",
        "undrift learn a.csv --date 2026-03-01 --calibration c.json --json",
    ),
    "correct": (
        "undrift correct walk.csv --calibration calibration.json -o walk.parquet",
        "undrift correct *.csv --calibration calibration.json -o corrected/",
        "undrift correct walk.csv --serial A17 -o walk.parquet",
    ),
    "orient": (
        "undrift orient corrected.parquet -o angles.csv",
        "undrift orient walk.csv --calibration calibration.json --offset rest -o a.csv",
    ),
    "validate": (
        "undrift validate walk.csv --calibration c.json --reference poses.csv -o out/",
        "undrift validate *.hdf5 --calibrate-from reference --leave-one-out --json",
        "undrift validate a.csv --reference v.c3d --markers A,B,C --reference-up z",
    ),
    "twin": (
        "undrift twin one.hdf5 two.hdf5 -o device.json",
        "undrift twin one.csv two.csv --reference one.c3d --reference two.c3d --json",
    ),
    "export": (
        "undrift export calibration.json --target c -o calibration.h",
        "undrift export calibration.json --target px4 -o calibration.params",
    ),
    "certificate": (
        "undrift certificate calibration.json -o certificate.pdf",
        "undrift certificate calibration.json -o certificate.pdf --json",
    ),
    "registry": (
        "undrift registry add calibration.json certificate.pdf",
        "undrift registry list",
    ),
    "registry add": (
        "undrift registry add calibration.json certificate.pdf",
        "undrift registry add c.json --supersedes 3 --note 'wrong gravity'",
        "undrift registry add session/ --registry postgresql://lab@db/undrift",
    ),
    "registry list": (
        "undrift registry list",
        "undrift registry list --serial A17 --json",
    ),
    "registry show": (
        "undrift registry show 3",
        "undrift registry show 3 -o calibration.json",
    ),
    "registry find": (
        "undrift registry find --serial A17 -o calibration.json",
        "undrift registry find --serial A17 --date 2026-03-01 --temp-c 31 --json",
    ),
    "registry due": (
        "undrift registry due",
        "undrift registry due --within-days 0 --json",
    ),
    "registry trend": (
        "undrift registry trend --serial A17",
        "undrift registry trend --serial A17 --figure trend.svg --report trend.html",
    ),
    "registry import": (
        "undrift registry import calibrations/",
        "undrift registry import old/ --serial A17 --valid-months 24",
    ),
    "noise": (
        "undrift noise rest.csv --map map.toml --figure allan.svg",
        "undrift noise rest.csv --calibration calibration.json --start-s 60 --json",
    ),
    "simulate": (
        "undrift simulate sit_to_stand --device mpu6050 --draw -o trial.parquet",
        "undrift simulate poses.csv --device device.json -o trial.csv --truth truth.csv",
        "undrift simulate thermal_soak --device mpu6050 -o soak/",
    ),
    "rig": (
        "undrift rig emulate --device mpu6050 --speed 20",
        "undrift rig stop --rig 'galil:tcp://192.168.1.9:23?encoder_lines=10000'",
    ),
    "rig run": (
        "undrift rig run p.toml --rig manual: --device tcp://127.0.0.1:9000 -o run/",
        "undrift rig run p.toml --rig manual: --device ble:A17 -o run/ --resume",
    ),
    "rig emulate": (
        "undrift rig emulate --device mpu6050 --speed 20",
        "undrift rig emulate --kind grbl --save-device truth.json --json",
        "undrift rig emulate --hand-held --device mpu6050",
    ),
    "rig stop": (
        "undrift rig stop --rig 'galil:tcp://192.168.1.9:23?encoder_lines=10000'",
        "undrift rig stop --rig grbl:serial:///dev/ttyUSB0",
    ),
    "rig status": (
        "undrift rig status --rig 'galil:tcp://192.168.1.9:23?encoder_lines=10000'",
        "undrift rig status --rig 'galil:tcp://127.0.0.1:2323' --json",
    ),
    "rig check": (
        "undrift rig check --rig 'galil:tcp://192.168.1.9:23?encoder_lines=10000'",
        "undrift rig check --rig grbl:serial:///dev/ttyUSB0 --turn-rate-dps 60 --json",
    ),
    "study": (
        "undrift study --preset note --quick",
        "undrift study study.toml --workers 4 -o study/",
    ),
    "bench": (
        "undrift bench",
        "undrift bench --port 0 --no-browser --folder bench/",
    ),
    "data": (
        "undrift data list",
        "undrift data fetch sample",
    ),
    "data list": (
        "undrift data list",
        "undrift data list --json",
    ),
    "data fetch": (
        "undrift data fetch sample -o first/",
        "undrift data fetch broad",
    ),
    "demo": (
        "undrift demo",
        "undrift demo --quick --out first_look",
    ),
}


def examples(command: str) -> str:
    """Return the end of a command's help."""
    return "Examples:\n" + "\n".join(f"  {line}" for line in EXAMPLES[command])
