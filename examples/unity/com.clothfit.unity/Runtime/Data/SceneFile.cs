using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Text;
using UnityEngine;

namespace Clothfit
{
    /// <summary>A scene with its extras, as text and as a file.</summary>
    public sealed class SceneFile
    {
        public readonly SceneData Scene;
        public readonly SceneExtras Extras;

        /// <summary>Joins both; the extras of objects and colliders are made as many as there are objects and colliders.</summary>
        public SceneFile(SceneData scene, SceneExtras extras)
        {
            Scene = scene;
            Extras = extras;
            while (extras.objects.Count < scene.objects.Count) extras.objects.Add(new ObjectExtras());
            while (extras.colliders.Count < scene.colliders.Count) extras.colliders.Add(new ColliderExtras());
        }

        /// <summary>Reads the text of a scene. Throws FormatException where it is none.</summary>
        public static SceneFile Parse(string json)
        {
            try
            {
                var scene = JsonUtility.FromJson<SceneData>(json);
                var extras = JsonUtility.FromJson<SceneExtras>(json);
                if (scene == null || extras == null || scene.objects.Count == 0) throw new FormatException("it has no objects");
                return new SceneFile(scene, extras);
            }
            catch (ArgumentException error) // what JsonUtility throws
            {
                throw new FormatException(error.Message, error);
            }
        }

        /// <summary>Reads a file. Throws IOException, and FormatException with the file's name.</summary>
        public static SceneFile Read(string path)
        {
            try
            {
                return Parse(File.ReadAllText(path)); // takes a byte order mark away
            }
            catch (FormatException error)
            {
                throw new FormatException(path + ": " + error.Message, error);
            }
        }

        /// <summary>Writes a file, whole or not at all, and its folder.</summary>
        public void Write(string path)
        {
            string full = Path.GetFullPath(path), temporary = full + ".part";
            Directory.CreateDirectory(Path.GetDirectoryName(full));
            File.WriteAllText(temporary, ToString(), new UTF8Encoding(false));
            if (File.Exists(full)) File.Replace(temporary, full, null);
            else File.Move(temporary, full);
        }

        /// <summary>The text of the scene; without extras just what JsonUtility writes.</summary>
        public override string ToString()
        {
            string json = JsonUtility.ToJson(WithoutLists());
            json = Filled(json, "objects", Scene.objects.Select((each, i) => Text(each, Extras.objects[i])));
            json = Filled(json, "colliders", Scene.colliders.Select((each, i) => Text(each, Extras.colliders[i])));
            var text = new JsonObject(json);
            text.Add("gravity", Extras.gravity).Add("windVelKeys", Keys(Extras.windVelKeys));
            text.Add("gravityKeys", Keys(Extras.gravityKeys)).Add("frame", Frame(Extras.frame));
            text.Add("planes", Extras.planes).Add("selfCollision", Contact(Extras.selfCollision));
            return text.Add("colliderOffset", Extras.colliderOffset).Add("fit", Fit(Extras.fit)).ToString();
        }

        SceneData WithoutLists()
        {
            return new SceneData
            {
                integrationMethod = Scene.integrationMethod, delta = Scene.delta, tolerance = Scene.tolerance,
                optimizationIterations = Scene.optimizationIterations, windVel = Scene.windVel,
                printTimes = Scene.printTimes, forwardSubSteps = Scene.forwardSubSteps, title = Scene.title,
            };
        }

        /// <summary>The text with items in a list that is empty in it; no text within a string can look like that.</summary>
        static string Filled(string json, string name, IEnumerable<string> items)
        {
            string empty = "\"" + name + "\":[]";
            int start = json.IndexOf(empty, StringComparison.Ordinal), end = start + empty.Length - 1;
            return json.Substring(0, end) + string.Join(",", items) + json.Substring(end);
        }

        static string Text(ObjectData data, ObjectExtras extras)
        {
            var json = new JsonObject(JsonUtility.ToJson(data));
            json.Add("springRestLength", extras.springRestLength).Add("vertVel", extras.vertVel);
            if (extras.pins.Count > 0) json.AddJson("pins", "[" + string.Join(",", extras.pins.Select(Pin)) + "]");
            return json.Add("pinOffset", extras.pinOffset).Add("warp", extras.warp).Add("fit", Fit(extras.fit)).ToString();
        }

        static string Text(ColliderData data, ColliderExtras extras)
        {
            var json = new JsonObject(JsonUtility.ToJson(data));
            json.Add("thickness", extras.thickness).Add("stiffness", extras.stiffness).Add("friction", extras.friction);
            json.Add("posKeys", Keys(extras.posKeys)).Add("rotKeys", Keys(extras.rotKeys));
            return json.Add("scaleKeys", Keys(extras.scaleKeys)).ToString();
        }

        static JsonObject Keys(KeysData keys)
        {
            var json = new JsonObject();
            if (!keys.IsSet) return json;
            if (keys.times.Count > 0) json.Add("times", keys.times).Add("values", keys.values);
            return json.Add("interpolation", keys.interpolation).Add("file", keys.file);
        }

        static string Pin(PinData pin)
        {
            var json = new JsonObject().Add("vertices", pin.vertices);
            json.Add("posKeys", Keys(pin.posKeys)).Add("rotKeys", Keys(pin.rotKeys));
            return json.Add("pivot", pin.pivot).ToString();
        }

        static JsonObject Frame(FrameData frame)
        {
            var json = new JsonObject().Add("posKeys", Keys(frame.posKeys)).Add("rotKeys", Keys(frame.rotKeys));
            return json.IsEmpty ? json : json.Add("pivot", frame.pivot);
        }

        static JsonObject Contact(ContactData contact)
        {
            var json = new JsonObject().Add("thickness", contact.thickness).Add("stiffness", contact.stiffness);
            return json.Add("friction", contact.friction);
        }

        static JsonObject Fit(SceneFit fit)
        {
            var json = new JsonObject();
            Letter(json, "windVel", fit.windVel);
            Letter(json, "gravity", fit.gravity);
            Letter(json, "windVelKeys", fit.windVelKeys);
            Letter(json, "friction", fit.friction);
            Letter(json, "contact", fit.contact);
            Letter(json, "colliderOffset", fit.colliderOffset);
            return json.Add("bounds", Bounds(fit.bounds));
        }

        static JsonObject Fit(ObjectFit fit)
        {
            var json = new JsonObject();
            Letter(json, "damping", fit.damping);
            Letter(json, "dragCoefficient", fit.dragCoefficient);
            Letter(json, "vertVel", fit.vertVel);
            Letter(json, "springRestLength", fit.springRestLength);
            Letter(json, "posKeys", fit.posKeys);
            Letter(json, "pinOffset", fit.pinOffset);
            return json.Add("bounds", Bounds(fit.bounds));
        }

        static void Letter(JsonObject json, string name, string letter)
        {
            if (letter != "n") json.Add(name, letter);
        }

        static JsonObject Bounds(BoundsData bounds)
        {
            var json = new JsonObject();
            json.Add("mass", bounds.mass).Add("stiffness", bounds.stiffness).Add("rest", bounds.rest);
            json.Add("damping", bounds.damping).Add("drag", bounds.drag).Add("velocity", bounds.velocity);
            json.Add("path", bounds.path).Add("shift", bounds.shift).Add("wind", bounds.wind);
            json.Add("gravity", bounds.gravity).Add("gusts", bounds.gusts).Add("friction", bounds.friction);
            return json.Add("contact", bounds.contact).Add("offset", bounds.offset);
        }
    }
}
