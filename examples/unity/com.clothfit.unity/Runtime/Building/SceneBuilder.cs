using System;
using System.Collections.Generic;
using System.Linq;
using UnityEngine;

namespace Clothfit
{
    /// <summary>From components to a scene.</summary>
    public static class SceneBuilder
    {
        /// <summary>
        /// The scene of a component and those below it. Throws InvalidOperationException, with a sentence for the user,
        /// where there is no cloth or one cannot be made.
        /// </summary>
        public static SceneFile Build(ClothfitScene settings)
        {
            List<ClothfitCloth> cloths = settings.All<ClothfitCloth>();
            List<ClothfitWind> winds = settings.All<ClothfitWind>();
            if (cloths.Count == 0) throw new InvalidOperationException(settings.name + ": there is no Clothfit Cloth in it");
            if (winds.Count > 1) throw new InvalidOperationException(settings.name + ": there are several winds; keep one");
            List<ClothfitObstacle> obstacles = settings.All<ClothfitObstacle>();
            ClothfitWind wind = winds.FirstOrDefault();
            var scene = new SceneData
            {
                integrationMethod = (int)settings.integrator, delta = settings.timeStep, tolerance = settings.tolerance,
                optimizationIterations = settings.frames, forwardSubSteps = settings.newtonIterations,
                objects = cloths.Select(Object).ToList(), colliders = obstacles.Select(Collider).ToList(),
                windVel = wind == null ? Vector3.zero : wind.velocity, title = settings.name,
            };
            SceneExtras extras = Extras(settings, wind, obstacles);
            List<ClothfitFixer> fixers = settings.All<ClothfitFixer>();
            for (int k = 0; k < cloths.Count; k++) extras.objects.Add(Held(cloths[k], scene.objects[k], fixers));
            return new SceneFile(scene, extras);
        }

        /// <summary>A cloth without fixers. Throws InvalidOperationException where none can be made.</summary>
        public static ObjectData Object(ClothfitCloth cloth)
        {
            Weld weld = cloth.Weld();
            Vector3[] places = weld.Places.Select(cloth.transform.TransformPoint).ToArray();
            Springs springs = SpringsOf(cloth, places, weld.Triangles);
            return new ObjectData
            {
                vertPos = places.ToList(), vertIsFixed = new bool[places.Length].ToList(),
                vertMass = Chosen(cloth.fitted.masses, springs.Mass), springs = springs.Ends,
                springStiffness = Chosen(cloth.fitted.stiffnesses, springs.Stiffness), triangles = weld.Triangles.ToList(),
                dragCoefficient = cloth.drag, damping = cloth.damping,
                optimizationSettings = Letters.Of(cloth.fitMass) + Letters.Of(cloth.fitStiffness),
            };
        }

        static Springs SpringsOf(ClothfitCloth cloth, Vector3[] places, int[] triangles)
        {
            if (triangles.Length == 0) throw new InvalidOperationException(cloth.name + ": the mesh has no triangles");
            try
            {
                return new Springs(places, triangles, cloth.density, cloth.stiffness, cloth.bendingSprings);
            }
            catch (ArgumentException error)
            {
                throw new InvalidOperationException(cloth.name + ": " + error.Message, error);
            }
        }

        /// <summary>Fitted values, or those of the material where there are none for this mesh.</summary>
        static List<float> Chosen(List<float> fitted, List<float> material)
        {
            return fitted.Count == material.Count ? new List<float>(fitted) : material;
        }

        /// <summary>Fixes the vertices that fixers hold, and gives what the object has besides.</summary>
        static ObjectExtras Held(ClothfitCloth cloth, ObjectData data, List<ClothfitFixer> fixers)
        {
            var extras = new ObjectExtras { fit = Fit(cloth) };
            foreach (ClothfitFixer fixer in fixers)
                for (int i = 0; i < data.vertPos.Count; i++)
                    if (fixer.Holds(data.vertPos[i])) data.vertIsFixed[i] = true;
            extras.pins = Pins(data, fixers).Select(each => Pin(each.Key, each.Value)).ToList();
            FittedValues found = cloth.fitted;
            int vertices = data.vertPos.Count;
            if (found.restLengths.Count == data.springStiffness.Count) extras.springRestLength = found.restLengths;
            if (found.velocities.Count == vertices) extras.vertVel = found.velocities;
            else if (cloth.velocity != Vector3.zero) extras.vertVel = Enumerable.Repeat(cloth.velocity, vertices).ToList();
            if (found.moved) extras.pinOffset = found.pinOffset;
            if (cloth.warp != Vector3.zero) extras.warp = cloth.transform.TransformDirection(cloth.warp);
            return extras;
        }

        /// <summary>The fixers that move vertices of a cloth, in the order of its pins; the first that holds a vertex moves it.</summary>
        public static List<KeyValuePair<ClothfitFixer, List<int>>> Pins(ObjectData data, List<ClothfitFixer> fixers)
        {
            var pins = new List<KeyValuePair<ClothfitFixer, List<int>>>();
            var taken = new bool[data.vertPos.Count];
            foreach (ClothfitFixer fixer in fixers.Where(each => each.Moves))
            {
                List<int> own = Enumerable.Range(0, taken.Length).Where(i => !taken[i] && fixer.Holds(data.vertPos[i])).ToList();
                foreach (int i in own) taken[i] = true;
                if (own.Count > 0) pins.Add(new KeyValuePair<ClothfitFixer, List<int>>(fixer, own));
            }
            return pins;
        }

        static PinData Pin(ClothfitFixer fixer, List<int> vertices)
        {
            return new PinData
            {
                vertices = vertices, posKeys = fixer.positionKeys.Data(), rotKeys = fixer.rotationKeys.Data(),
                pivot = fixer.rotationKeys.IsSet ? fixer.transform.position : Unset.Vector,
            };
        }

        static ObjectFit Fit(ClothfitCloth cloth)
        {
            return new ObjectFit
            {
                damping = Letters.Of(cloth.fitDamping), dragCoefficient = Letters.Of(cloth.fitDrag),
                vertVel = Letters.Of(cloth.fitVelocity), springRestLength = Letters.Of(cloth.fitRestLength),
                posKeys = cloth.fitPaths ? "L" : "n", pinOffset = Letters.Of(cloth.fitPinOffset),
                bounds = FitBounds.Data(cloth.bounds),
            };
        }

        static ColliderData Collider(ClothfitObstacle obstacle)
        {
            Transform place = obstacle.transform;
            return new ColliderData
            {
                type = obstacle.Type, pos = place.position, rot = place.eulerAngles, scale = place.lossyScale,
            };
        }

        static SceneExtras Extras(ClothfitScene settings, ClothfitWind wind, List<ClothfitObstacle> obstacles)
        {
            if (wind == null && (settings.fitWind || settings.fitWindKeys))
                throw new InvalidOperationException(settings.name + ": the wind is to be fitted; add a Clothfit Wind");
            bool planes = obstacles.Any(each => each.Type == Obstacles.Plane);
            return new SceneExtras
            {
                gravity = settings.ownGravity ? settings.gravity : Unset.Vector,
                windVelKeys = wind == null ? new KeysData() : wind.keys.Data(), gravityKeys = settings.gravityKeys.Data(),
                planes = planes && settings.solidPlanes ? "solid" : "", selfCollision = settings.selfContact.Data(),
                colliderOffset = settings.obstacleOffset == Vector3.zero ? Unset.Vector : settings.obstacleOffset,
                colliders = obstacles.Select(Surface).ToList(), fit = Fit(settings),
            };
        }

        static ColliderExtras Surface(ClothfitObstacle obstacle)
        {
            ContactData contact = obstacle.contact.Data();
            return new ColliderExtras
            {
                thickness = contact.thickness, stiffness = contact.stiffness, friction = contact.friction,
                posKeys = obstacle.positionKeys.Data(), rotKeys = obstacle.rotationKeys.Data(),
                scaleKeys = obstacle.scaleKeys.Data(),
            };
        }

        static SceneFit Fit(ClothfitScene settings)
        {
            return new SceneFit
            {
                windVel = Letters.Of(settings.fitWind), gravity = Letters.Of(settings.fitGravity),
                windVelKeys = settings.fitWindKeys ? "L" : "n", friction = Letters.Of(settings.fitFriction),
                contact = Letters.Of(settings.fitContact), colliderOffset = Letters.Of(settings.fitObstacleOffset),
                bounds = FitBounds.Data(settings.bounds),
            };
        }
    }
}
