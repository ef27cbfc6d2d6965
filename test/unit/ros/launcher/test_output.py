from bullet_lab.ros.launcher.output import PlainText


def test_text_for_a_full_disk_is_lost_without_an_error():
    with open("/dev/full", "wb", buffering=0) as full:
        print("lost", file=PlainText(full), flush=True)
